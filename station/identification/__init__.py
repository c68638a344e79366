"""A record in, derivatives out: what is made of a recording after a flight, and its report."""
