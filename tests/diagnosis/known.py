"""A profile that says that it is right: what diagnosis may then take as known."""

from __future__ import annotations

from station.profile import Aircraft
from station.profile.uncertainty import Uncertainty

EXACT = Uncertainty.model_validate(dict.fromkeys(Uncertainty.model_fields, 0.0), context="si")


def surely(aircraft: Aircraft, **unknown: float) -> Aircraft:
    """The aircraft with every constant and derivative known, but for `unknown` of its uncertainty, SI."""
    derivatives = {n: d.model_copy(update={"sd": 0.0}) for n, d in aircraft.derivatives.items()}
    return aircraft.model_copy(update={"derivatives": derivatives, "uncertainty": EXACT.model_copy(update=unknown)})
