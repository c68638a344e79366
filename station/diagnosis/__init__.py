"""Where measured and simulated flight part company, why, and what mending the model gains."""
