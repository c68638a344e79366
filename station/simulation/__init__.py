"""The simulated aircraft, air and instruments: pure numerics."""

from station.simulation.longitudinal import Simulation
from station.simulation.simulate import fly

__all__ = ["Simulation", "fly"]
