"""The simulated aircraft, air and instruments: pure numerics."""

from station.simulation.sortie import fly
from station.simulation.three_degrees import Simulation

__all__ = ["Simulation", "fly"]
