"""Pure numerics of estimation: state in, state out, time as an argument."""
