"""What comes in over links and from files that is wrong, too much, or somebody else's; and a flight of an hour."""

from __future__ import annotations

import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from station.convert import import_file
from station.log import summarise
from station.rows import LogError
from tests.reliability import live_links, speakers
from tests.reliability.clocks import BUSY, exchanged, jumped, mapped, sent, stalled, starved
from tests.reliability.counts import GROWTH_MIB
from tests.reliability.crafted import KINDS, cost
from tests.reliability.foreign import AIRCRAFT, DATAFLASH, dataflash, mat, ulog
from tests.reliability.hurting import mutated
from tests.reliability.mutated_links import links
from tests.reliability.mutations import added
from tests.reliability.recordings import Told
from tests.reliability.wraps import fly as fly_wraps
from tests.reliability.wraps import wrapping

SETTLED = 250
"""Messages at 50 Hz after a jump, until shorter exchanges have come."""
SLOPE = 1.0
"""MiB an hour that the station's memory may grow by, from 10 min on."""


def foreign(inputs: int) -> Told:
    """Files from elsewhere, damaged: each ends in a LogError or in a recording that can be read."""
    worst, bad = 0.0, 0
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        sources = {
            "mat": [mat(work / "made.mat", False), mat(work / "made.mat", True)],
            "bin": [dataflash([1_000_000 + k * 20_000 for k in range(100)])],
            "ulg": [ulog()],
        }
        noise = random.Random(3)
        for kind, whole in sources.items():
            for _ in range(inputs):
                path, out = work / f"a.{kind}", work / "a.mcap"
                out.unlink(missing_ok=True)
                path.write_bytes(mutated(noise.choice(whole), noise))
                began = time.monotonic()
                try:
                    import_file(path, out, AIRCRAFT, (DATAFLASH,))
                    summarise(out)
                except LogError:
                    bad += out.exists()
                worst = max(worst, time.monotonic() - began)
    grown = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    words = f"{bad} left a recording that cannot be read; {worst:.1f} s and {grown:.0f} MiB at most"
    return f"damaged .mat, .bin and .ulg, {inputs} of each", "0; 65 s", words, not bad and worst < 65


def clock_jumps(links: int) -> Told:
    """Device clocks that jump by 3 ms to an hour, each way, on links whose delays let 3 ms be seen."""
    sizes_s = [j * 1e-3 for j in (3, 4, 6, 10, 15, 19)] + [0.1, 2.0, 3600.0]
    late, wrong, worst = 0.0, 0, 0.0
    rng = np.random.default_rng(1)
    kinds = [("an adapter's millisecond", 5), ("an adapter's millisecond", 200), ("a network's 1 ms, exponential", 100)]
    for _ in range(links):
        for delay, rate in kinds:
            for by_s in (sign * size for size in sizes_s for sign in (-1, 1)):
                messages, first = jumped(sent(rate, 40.0, delay, rng), 30.0, by_s)
                found = mapped(messages)
                wrong += len(found.told) != 1
                if found.told:
                    late = max(late, float(messages.arrival[found.told[0]] - messages.arrival[first]) * 1e-9)
                    worst = max(worst, float(np.abs(found.error_s[found.told[0] + 1 :]).max()))
    count = links * len(kinds) * 2 * len(sizes_s)
    words = f"{wrong} not told, or told twice; told after {late:.2f} s, then off by {worst * 1e3:.2f} ms at most"
    holds = not wrong and late <= 1 and worst <= 0.002
    return f"device clocks that jump by 3 ms to 1 h, {count}", "0; 1 s, 2 ms", words, holds


def jumps_behind_a_queue(links: int) -> Told:
    """Clocks that jump where messages wait for up to 10 ms before they are sent, by turns: time sync tells of it."""
    sizes_s = [j * 1e-3 for j in (6, 10, 15, 19)] + [0.1, 2.0, 3600.0]
    late, wrong, worst, before = 0.0, 0, 0.0, 0
    rng = np.random.default_rng(1)
    for _ in range(links):
        for by_s in (sign * size for size in sizes_s for sign in (-1, 1)):
            messages, first = jumped(sent(50, 60.0, BUSY, rng), 30.0, by_s)
            exchanges = list(exchanged(messages, "a network's 1 ms, exponential", rng))
            found = mapped(messages, exchanges=exchanges)
            wrong += len(found.told) != 1
            before += len(mapped(messages, 5, exchanges).told) != 1
            if found.told:
                late = max(late, float(messages.arrival[found.told[0]] - messages.arrival[first]) * 1e-9)
                worst = max(worst, float(np.abs(found.error_s[first + SETTLED :]).max()))
    words = f"{wrong} not told, or told twice ({before} by clock law 5); told after {late:.2f} s"
    words += f", from 5 s on off by {worst * 1e3:.2f} ms at most"
    name = f"device clocks that jump by 6 ms to 1 h behind a queue of 10 ms, with time sync, {links * 2 * len(sizes_s)}"
    return name, "0; 1 s, 2 ms", words, not wrong and late <= 1 and worst <= 0.002


def stalls_of_the_station(hours: float) -> Told:
    """Sound clocks on a machine that stands still, loses what its buffers do not hold, or starves its readers."""
    rng, told, before = np.random.default_rng(2), 0, 0
    for rate in (1, 5, 50, 100, 200):
        sound = sent(rate, hours * 720, "a network's 1 ms, exponential", rng)
        held, lost = (stalled(sound, rng, is_lossy=lossy) for lossy in (False, True))
        told += sum(len(mapped(messages).told) for messages in (held, lost, starved(sound, rng)))
        before += len(mapped(lost, law=1).told)
    words = f"{told} jumps told of clocks that did not jump ({before} by clock law 1)"
    return f"a machine that stalls, {hours:g} h of five links", "0", words, not told


def crafted_bytes() -> Told:
    """The bytes that keep each reader busiest, through the adapter."""
    worst, which, bad = 0.0, "", 0
    for name, kinds in KINDS.items():
        for kind, data in kinds.items():
            share, _, unaccounted = cost(links()[name].codec(), data)
            bad += bool(unaccounted)
            worst, which = max((worst, which), (share, f"{name}, {kind}"))
    words = f"{worst:.0%} of a core ({which}); {bad} with bytes unaccounted for"
    count = sum(map(len, KINDS.values()))
    return f"1 MB/s of crafted bytes, {count} kinds", "20 %; 0", words, worst < 0.2 and not bad


def fast_links(streams: int, rate: int, seconds: float, *, is_flooded: bool) -> Told:
    """Links of the operating system in its time, and a flood of datagrams beside them."""
    found = live_links.fly(streams, rate, seconds, is_flooded=is_flooded)
    missing = found.sent - found.recorded
    words = (
        f"{missing} of {found.sent} samples missing, {found.ticks_missed} of {found.ticks} ticks missed, "
        f"{found.autopilot} of {found.autopilot_sent} messages of the autopilot; {found.core:.2f} of a core"
    )
    name = f"{streams} streams at {rate} Hz, {seconds:g} s"
    if is_flooded:
        name += f", and {found.flooded / seconds / 1000:.0f} thousand datagrams a second from elsewhere"
    limit = "0, 0; 1 core"
    return name, limit, words, not missing and not found.ticks_missed and found.core < 1


SO_FAR = " so far"


def mutations(name: str, inputs: int, seconds: float, kept: Path | None = None) -> Told:
    """Bad inputs of one codec or reader: those of before in `kept`, and more for so much processor time."""
    found = added(name, inputs, seconds, kept)
    words, is_short = found.words(), found.inputs < inputs
    if found.is_sound and is_short:
        words += f"; {found.inputs} of {inputs}{SO_FAR}"
    return (
        f"mutated inputs of {name}, {found.inputs}",
        f"0; {found.limit_s:g} s, {GROWTH_MIB:g} MiB",
        words,
        found.is_sound and not is_short,
    )


def all_wraps(turns: int) -> Told:
    """Times and numbers of messages, past the ends of their counters and after silences of up to three of them."""
    found = {name: fly_wraps(one, turns, seed=1) for name, one in wrapping().items()}
    worst, numbers = max(f.worst_ns for f in found.values()), sum(f.numbers for f in found.values())
    words = f"{worst * 1e-6:.1f} ms off at most, {numbers} numbers wrong ({', '.join(found)})"
    total = sum(f.wraps for f in found.values())
    return f"counters of {len(found)} links that wrap, {total} times", "1 ms, 0", words, worst <= 10**6 and not numbers


def foreign_senders(messages: int) -> Told:
    """Half of the messages of a link are others': of the rig's vehicle, and of the first autopilot that is heard."""
    found = [speakers.foreign(messages // 2, seed=1, system_id=named) for named in (1, None)]
    mixed, missing = sum(f.mixed for f in found), sum(f.sent - f.taken for f in found)
    uncounted = sum(f.others - f.counted for f in found)
    words = f"{mixed} taken for the vehicle's, {uncounted} uncounted; {missing} of the vehicle's missing"
    holds = not (mixed or missing or uncounted)
    return f"messages of foreign senders, {sum(f.others for f in found)}", "0, 0; 0", words, holds


def wrong_signatures(messages: int) -> Told:
    """On a signed link, beside what the vehicle signs: unsigned, another key's, altered, too old, played back."""
    found = speakers.forged(messages, seed=1)
    words = f"{found.mixed} taken, {found.others - found.counted} uncounted; {found.sent - found.taken} signed missing"
    holds = not found.mixed and found.others == found.counted and found.sent == found.taken
    return f"messages wrongly signed, {found.others}", "0, 0; 0", words, holds


def soak(minutes: float, *, stressed: bool = False) -> Told:
    """The whole station on its bench, before all else that runs where root may; `stressed`: one core is kept busy."""
    words = [sys.executable, "tests/benchmarks/live_flight.py", "--minutes", str(minutes), "--view", "none"]
    words += ["--stress"] if stressed else []
    if os.geteuid() == 0 and shutil.which("chrt"):
        words = ["chrt", "-r", "5", *words]
    done = subprocess.run(words, cwd=Path(__file__).parents[2], stdout=subprocess.PIPE, text=True, check=True)
    return soaked(done.stdout, minutes, stressed=stressed)


def soaked(told: str, minutes: float, *, stressed: bool = False) -> Told:
    """Of what live_flight.py prints."""
    missed = re.search(r"(\d+) missed", told)
    slope = re.search(r"min on: ([+-][\d.]+) MiB/h", told)
    late = re.search(r"([\d.]+) ms \(p99\)", told)
    beside = re.search(r"^(.*load .*); files: (\d+); exit code: (\d+)$", told, re.MULTILINE)
    assert missed is not None, told
    assert late is not None, told
    assert beside is not None, told
    grown = f"{slope[1]} MiB/h from 10 min on" if slope else "too short for the memory's slope"
    still = r"^the machine itself (.*?(?:; ticks missed while a core of it did: (\d+))?)$"
    stood = re.search(still, told, re.MULTILINE)
    words = f"ticks missed: {missed[1]}, {late[1]} ms (p99); {grown}; files: {beside[2]}, exit code {beside[3]}"
    words += f"; the machine itself {stood[1]}" if stood else ""
    name = f"a flight of {minutes:g} min on the bench{', one core kept busy' * stressed}, {beside[1]}"
    # What the machine itself loses, no process on it can keep.
    holds = int(missed[1]) == int((stood and stood[2]) or 0) and not int(beside[3])
    if not stressed:
        holds &= slope is not None and float(slope[1]) < SLOPE
    return name, "0" if stressed else f"0; {SLOPE:g} MiB/h", words, holds
