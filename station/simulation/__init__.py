"""The simulated aircraft, air and instruments: pure numerics."""

from station.simulation.simulate import Simulation, fly

__all__ = ["Simulation", "fly"]
