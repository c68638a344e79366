"""The simulated aircraft, air and instruments: pure numerics."""
