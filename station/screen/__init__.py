"""What the operator sees: the terminal, the Rerun page, and the go / no-go table."""
