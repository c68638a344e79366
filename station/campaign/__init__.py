"""Monte Carlo campaigns: many simulated flights, each estimated, one row a flight and method."""
