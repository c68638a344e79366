"""station emulate: the emulated devices alone."""

from __future__ import annotations

import json
import threading

from station.clock import SystemClock
from station.commands.cards import load, recorded_flight
from station.commands.common import CardName
from station.commands.process import stop_on_signals, write_line
from station.console import DONE


def emulate(card: CardName = "bench") -> int:
    """Serve the card's emulated devices alone; one JSON line per endpoint."""
    from drivers.adapter import check_devices
    from drivers.emulation import serve

    profiles = load(card)
    check_devices(profiles.rig, profiles.rig_file)
    stop = threading.Event()
    stop_on_signals(stop)
    serve(profiles, lambda told: write_line(json.dumps(told)), stop, SystemClock(), recorded_flight(profiles))
    return DONE
