"""The estimators of a flight: the only place that wires them together, for run and replay alike."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from station.conventions import LONGITUDINAL, TICK_HZ
from station.estimation.change_monitor import ChangeMonitor
from station.estimation.instrument_errors import Corrector, corrector, known
from station.estimation.method_table import LIVE
from station.estimation.methods import Estimator
from station.estimation.physical_method import UPDATE_TICKS, Physical
from station.estimation.second_vane import second_vanes
from station.flight.loop import Chain
from station.model.disagreement import Disagreement
from station.model.physical_signals import SIGNALS
from station.numerics.default_noise import DEFAULT_NOISE
from station.profile import Aircraft, Card, Profiles, Rig, elsewhere

FORGETTING_S: Final = 120.0
"""Four test inputs or more of one each 20 to 30 s, as many as make a point; ice that builds up in minutes is seen."""


def chain(aircraft: Aircraft, card: Card, rig: Rig) -> Chain:
    """What corrects, estimates and watches in a flight, all compiled: no tick of it has to."""
    place, noise = rig.imu_position, rig.frame_noise_si()
    forgetting = forgetting_s(aircraft, card)
    estimator = Estimator(aircraft, card, place, noise, forgetting_s=forgetting)
    estimator.warm_up()
    monitor = None
    if aircraft.measured:
        monitor = ChangeMonitor(aircraft, forgetting, estimator.within_model, estimator.thrust)
    watch = Disagreement(aircraft, place, noise, estimator.sideslip)
    watch.warm_up()
    vanes = second_vanes(elsewhere(rig.signals, "alpha_vane"), rig.further.index, aircraft)
    return Chain(estimator, watch, corrector(aircraft, noise, place), monitor, vanes)


def forgetting_s(aircraft: Aircraft, card: Card) -> float:
    """With what time constant the live estimates forget: the card's; where the aircraft is held against its baseline,
    FORGETTING_S; else never."""
    if card.forgetting is not None:
        return card.forgetting
    return FORGETTING_S if aircraft.measured else math.inf


def undone(aircraft: Aircraft, correct: object) -> str:
    """For the operator, what of the profile's instrument errors is undone in this flight, and what it costs; "" where
    the profile states none."""
    stated, lines = known(aircraft), []
    if stated.words:
        ahead = correct.ahead if isinstance(correct, Corrector) else 0
        late = f"; estimates come {1000 * ahead // TICK_HZ} ms later" if ahead else ""
        count = f"{len(stated.words)} instrument error{'s' if len(stated.words) > 1 else ''}"
        lines.append(f"{aircraft.name} states {count}, undone: {'; '.join(stated.words)}{late}")
    lines += [f"{aircraft.name}: an instrument error stays in: {words}" for words in stated.refused]
    return "\n".join(lines)


def compile_kernels(profiles: Profiles, part: str) -> None:
    """Compile one of the two halves, of like length, of what `chain` needs: "physical", the method's fit, or "signals",
    all else."""
    aircraft, card = profiles.aircraft, profiles.card.model_copy(update={"warm_up": 0.0})
    place, noise = profiles.rig.imu_position, profiles.rig.frame_noise_si()
    if part == "physical":
        made = Physical(aircraft, card, {**DEFAULT_NOISE, **noise}, LONGITUDINAL, 1.0 / TICK_HZ)
        samples = np.random.default_rng(0).standard_normal((2 * UPDATE_TICKS, SIGNALS + 4))
        for k, row in enumerate(samples):
            made.add(row[:SIGNALS], row[SIGNALS:], k / TICK_HZ, 50.0, 1.0, 0.1)
        return
    simple = tuple(name for name in LIVE if name != "physical")
    Estimator(aircraft, card, place, noise, simple).warm_up()
    Disagreement(aircraft, place, noise).warm_up()
    corrector(aircraft, noise, place)
