"""station check: opens every device and prints go / no-go."""

from __future__ import annotations

import math
import threading
from contextlib import ExitStack
from typing import Annotated

import typer

from station.clock import SystemClock
from station.commands.cards import about_air, about_vane, load
from station.commands.common import CardName, FlownAircraft, finite
from station.commands.process import stop_on_signals
from station.commands.run import emulated_flight, surface_tap
from station.console import DEGRADED, DONE, say
from station.flight.bus import Bus
from station.flight.emulators import streams_flown
from station.rows import Event, Sample


def check(
    card: CardName = "bench",
    aircraft: FlownAircraft = None,
    seconds: Annotated[float, typer.Option(help="how long to listen", min=0.5, callback=finite)] = 5.0,
) -> int:
    """Validate the profiles, listen to each device, print a go / no-go table."""
    from drivers.adapter import check_devices, open_devices, what_is_sent
    from station.flight import loop as live
    from station.flight.alignment import Aligner
    from station.flight.board import Board
    from station.flight.reach import travel_remarks, without_effect
    from station.screen.go_no_go import print_check, print_signals, print_steps

    profiles = load(card, aircraft)
    check_devices(profiles.rig, profiles.rig_file)
    for words in (*about_air(profiles.rig, profiles.aircraft), *about_vane(profiles.aircraft)):
        say(words)
    unasked = profiles.card.model_copy(update={"steps": ()})  # those of the steps stand in their table
    for words in (*travel_remarks(unasked, profiles.aircraft), *without_effect(profiles, profiles.card.emulate)):
        say(words)
    clock, bus, stop = SystemClock(), Bus(), threading.Event()
    board = Board(profiles, clock)
    told: list[Event] = []
    newest: dict[str, float] = {}
    heard_at: dict[str, list[int]] = {}
    with ExitStack() as stack:
        tap = surface_tap(stack, profiles)
        emulated = emulated_flight(stack, profiles, bus, clock, tap)
        put = tap.putting(bus.put) if tap is not None else bus.put
        streams = streams_flown(profiles.rig, emulated)
        aligner = Aligner(streams, profiles.rig.noise_si(), further=profiles.rig.further)
        aligner.hold()  # what the streams are like needs no frames
        for adapter in open_devices(profiles.rig, emulated.endpoints, profiles.rig_dir, clock, put):
            adapter.start()
            stack.callback(adapter.stop)
        stop_on_signals(stop)
        # The last beat carries a health row: they come once a second.
        signals_of = {s.name: s.signals for s in streams}
        now_ns = 0
        for tick, rows, _ in live.beats(bus, clock, profiles.card.lag, stop, math.ceil(seconds) + 0.02):
            now_ns = tick.t_ns
            for row in rows:
                aligner.accept(row)
                if isinstance(row, Sample):
                    heard_at.setdefault(row.stream, []).append(row.t_ns)
                    newest.update(zip(signals_of.get(row.stream, ()), row.values, strict=False))
            _, events, health = aligner.frame(tick.k, tick.t_ns, tick.frame_t_ns)
            told += [e for e in (*rows, *events) if isinstance(e, Event)]
            board.update([*rows, *events, *([health] if health else [])])
    heard = {s.stream for s in board.health.streams if s.alive} if board.health is not None else set()
    signals = {name for stream in streams if stream.name in heard for name in stream.signals}
    sent = {device.name: what_is_sent(device) for device in profiles.rig.devices}
    if profiles.card.emulate and profiles.rig.loop is not None:
        sent["the loop"] = profiles.rig.loop.sent
    rates = {name: (len(at) - 1) / (1e-9 * (now_ns - at[0])) for name, at in heard_at.items() if now_ns > at[0]}
    go = print_check(profiles.card.name, board, streams, told, sent, rates, seconds)
    go &= print_signals(profiles.rig, newest)
    return DONE if print_steps(profiles, signals) and go else DEGRADED
