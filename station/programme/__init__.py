"""A flight as a programme: its test points by every method, the baseline, and what has changed against it."""
