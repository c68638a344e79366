"""A rig proposed from what was heard: which field is which signal, and the file with the reasons beside.

What a field usually is, the shipped rigs say: a message that one of them maps is proposed as there, with its unit and
noise. Fields whose meaning no protocol tells (counts of a box, numbers of a line) are asked for.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from drivers.listening import Heard
from station.conventions import SIGNALS, UNIT_ALIASES, UNITS, unit_named
from station.profile import Card, Channel, Rig, load_rig, nearest
from station.rows import UsageError

SHIPPED: Final = ("mavlink_only", "mixed", "boom_serial", "vectornav", "dronecan")
"""Rigs that between them map each protocol's usual messages."""
_IMU: Final = (
    *(("ax", "xacc", "g"), ("ay", "yacc", "g"), ("az", "zacc", "g")),
    *(("p", "xgyro", "rad/s"), ("q", "ygyro", "rad/s"), ("r", "zgyro", "rad/s")),
)
_SCALED: Final = ("SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
ALSO: Final[Mapping[tuple[str, str | int], Mapping[str, Channel]]] = {
    ("msp", "AOA"): {
        "alpha_vane": Channel(field="aoa", unit="deg"),
        "beta_vane": Channel(field="sideslip", unit="deg"),
    },
    ("mavlink", "ATTITUDE"): {
        "p": Channel(field="rollspeed", unit="rad/s"),
        "q": Channel(field="pitchspeed", unit="rad/s"),
        "r": Channel(field="yawspeed", unit="rad/s"),
    },
    ("mavlink", "GLOBAL_POSITION_INT"): {
        "v_north": Channel(field="vx", unit="m/s"),
        "v_east": Channel(field="vy", unit="m/s"),
        "v_down": Channel(field="vz", unit="m/s"),
    },
    ("mavlink", "RAW_IMU"): {n: Channel(field=f, unit=u, slope=1e-3) for n, f, u in _IMU},
    **{("mavlink", m): {n: Channel(field=f, unit=u) for n, f, u in _IMU} for m in _SCALED},
    ("mavlink", "VFR_HUD"): {"airspeed": Channel(field="airspeed", unit="m/s")},
    ("mavlink", "SCALED_PRESSURE"): {"dynamic_pressure": Channel(field="press_diff", unit="hPa")},
}
"""What autopilots send where they have no HIGHRES_IMU nor AIRSPEED."""
MAY_LACK: Final = ("press_diff",)
"""Fields that are 0 throughout where the sensor is not there."""
UNNAMED: Final = ("boombox", "boombox_ascii", "lines")
"""Protocols whose fields mean what the rig says,"""
OUTPUTS: Final = ("SERVO_OUTPUT_RAW", "ACTUATOR_OUTPUT_STATUS", "uavcan.equipment.actuator.Status")
"""and an autopilot's or servo's outputs. One that is 0 throughout is not connected, and is not asked for."""
CAVEATS: Final[Mapping[tuple[str, str], str]] = {
    ("VFR_HUD", "airspeed"): "most autopilots send indicated airspeed here: true airspeed is wanted",
    ("AIRSPEED", "airspeed"): "most autopilots send indicated airspeed here: true airspeed is wanted",
    ("INS", "altitude"): "above the ellipsoid",
    **{("RAW_IMU", n): f"ArduPilot's in m{u}: other autopilots send counts of the sensor here" for n, _, u in _IMU},
}
"""What to mind of a signal in a message."""
RATES: Final = (1, 2, 4, 5, 8, 10, 20, 25, 40, 50, 100, 125, 200, 250, 400, 500, 800, 1000)
MOST_ASKED: Final = 12
"""Fields of one message that are asked for."""

WHICH: Final = "Which signal?\n(SIGNAL:UNIT[:SLOPE[:ZERO]], like alpha_vane:deg; empty: none)"
WHICH_SURFACE: Final = (
    "Which surface does it move?\n(SURFACE:deg:SLOPE:ZERO, deg = SLOPE x (value - ZERO), like elevator:deg:0.05:1500; "
    "empty: none)"
)
PLACE: Final = "0.1 m, 0 m, -0.02 m"
WHERE: Final = (
    f"where from the centre of gravity?\n(forward, right, down, like {PLACE}; empty: at it. Half a chord not told can "
    "turn the sign of CL_de)"
)

Ask = Callable[[str], str]
"""A question and its answer, empty for none."""


@dataclass(slots=True)
class Proposal:
    """Which field of which heard device is which signal; every signal comes from one place."""

    devices: list[tuple[str, Heard, dict[str | int, dict[str, Channel]]]] = field(default_factory=list)
    passed_over: dict[str, list[str]] = field(default_factory=dict)
    """By device: what was heard and is not used, in words."""

    def signals(self) -> dict[str, str]:
        """Where each comes from."""
        return {n: name for name, _, streams in self.devices for channels in streams.values() for n in channels}


def usual() -> dict[tuple[str, str | int], Mapping[str, Channel]]:
    """By protocol (or link) and message what each field usually is."""
    found = dict(ALSO)
    for rig in map(load_rig, SHIPPED):
        for device in rig.devices:
            kind = getattr(device, "protocol", device.link)
            for stream in device.streams if kind not in UNNAMED else ():
                key = (kind, stream.message)
                found[key] = {**stream.signals, **found.get(key, {})}
    return found


def propose(heard: Sequence[Heard], ask: Ask, maps: Sequence[str]) -> Proposal:
    """Signals of what was heard, in order: who comes first has a signal. `maps`: FIELD=SIGNAL:UNIT[:SLOPE[:ZERO]] for
    fields whose meaning is not known; `ask` for those that no map names. Raises UsageError for a map that fits none."""
    told = dict(_mapped(text) for text in maps)
    known, made = usual(), Proposal()
    for found in heard:
        name = _name(found, [n for n, _, _ in made.devices])
        streams: dict[str | int, dict[str, Channel]] = {}
        over = made.passed_over.setdefault(name, [])
        made.devices.append((name, found, streams))
        for message in sorted(found.messages, key=lambda m: (-found.messages[m].count, str(m))):
            fields = found.messages[message].fields
            if found.protocol in UNNAMED or message in OUTPUTS:
                wanted = _asked(name, found, message, ask, told)
            else:
                there = [f for f, seen in fields.items() if any(seen) or f not in MAY_LACK]
                wanted = {n: c for n, c in known.get((found.protocol, message), {}).items() if c.field in there}
            taken = made.signals()
            streams[message] = {n: c for n, c in wanted.items() if n not in taken}
            rest = ", ".join(f"{n} (from {taken[n]})" for n in wanted if n in taken)
            if rest or not wanted:
                over.append(f"{message} at {_rate(found, message)} Hz: {rest or ' '.join(list(fields)[:MOST_ASKED])}")
    if told:
        raise UsageError(
            f"--map: no field {', '.join(told)} was heard\nheard: {'; '.join(map(describe, heard)) or 'nothing'}"
        )
    return made


def _mapped(text: str) -> tuple[str, tuple[str, Channel]]:
    """Field, signal and channel of a map's text. Raises UsageError."""
    name, is_given, rest = text.partition("=")
    if not is_given:
        raise UsageError(f"--map {text}: FIELD=SIGNAL:UNIT[:SLOPE[:ZERO]], like v0=alpha_vane:deg:0.005")
    return name, _channel(name.rpartition(".")[2], rest)


def _channel(field_name: str, text: str) -> tuple[str, Channel]:
    """Signal and channel of SIGNAL:UNIT[:SLOPE[:ZERO]]. Raises UsageError saying what does not fit."""
    signal, *words = (word.strip() for word in text.split(":"))
    if signal not in SIGNALS:
        raise UsageError(f"no signal {signal}{nearest(signal, tuple(SIGNALS))}")
    if not words:
        fitting = ", ".join(n for n, u in UNITS.items() if u.si == SIGNALS[signal].unit and n not in UNIT_ALIASES)
        raise UsageError(f"{text}: in which unit? like {text}:{fitting.partition(',')[0]}; fitting: {fitting}")
    unit = words[0]
    try:
        slope, zero = (float(x) for x in (*words[1:], *("1", "0")[len(words[1:]) :]))
        channel = Channel(field=field_name, unit=unit, slope=slope, zero=zero)
    except ValidationError as error:
        raise UsageError(f"{text}: {error.errors()[0]['msg']}") from error
    except ValueError as error:
        raise UsageError(f"{text}: slope and zero are numbers: SIGNAL:UNIT[:SLOPE[:ZERO]]") from error
    if unit_named(unit).si != SIGNALS[signal].unit:  # type: ignore[union-attr]
        raise UsageError(f"{text}: {signal} is in {SIGNALS[signal].unit}: {unit} does not fit")
    return signal, channel


def _asked(
    name: str, found: Heard, message: str | int, ask: Ask, told: dict[str, tuple[str, Channel]]
) -> dict[str, Channel]:
    wanted: dict[str, Channel] = {}
    is_output = message in OUTPUTS
    fields = [(n, x) for n, x in found.messages[message].fields.items() if any(x) or not is_output]
    for field_name, (low, high, last) in fields[:MOST_ASKED]:
        keys = (f"{name}.{message}.{field_name}", f"{message}.{field_name}", field_name)
        key = next((k for k in keys if k in told), None)
        if key is not None:
            signal, channel = told.pop(key)
            wanted[signal] = channel
            continue
        which = WHICH_SURFACE if is_output else WHICH
        question = f"{name}, message {message}, {field_name}: {low:g} to {high:g}, now {last:g}. {which}"
        while answer := ask(question):
            try:
                signal, channel = _channel(field_name, answer)
                if signal in wanted:
                    raise UsageError(f"{signal} is {wanted[signal].field} already; empty: none")
            except UsageError as error:
                question = f"{error}\n{field_name}"
                continue
            wanted[signal] = channel
            break
    return wanted


def _name(found: Heard, taken: Sequence[str]) -> str:
    base = {"mavlink": "autopilot", "dronecan": "bus", "ubx": "gnss", "nmea": "gnss", "vectornav": "ins"}.get(
        found.protocol, "vane" if found.protocol in ("lines", "msp") else "boom"
    )
    return next(n for n in (base, *(f"{base}{i}" for i in range(2, 100))) if n not in taken)


def _rate(found: Heard, message: str | int) -> int:
    """The usual rate that is nearest to what was heard."""
    heard = found.rate(message)
    return min(RATES, key=lambda rate: abs(rate - heard) / rate)


def describe(found: Heard) -> str:
    """What was heard of a device, in a line."""
    where = f"{found.address}{f' at {found.baud} baud' if found.baud else ''}"
    said = ", ".join(f"{m} {_rate(found, m)} Hz" for m in list(found.messages)[:MOST_ASKED])
    return f"{where}: {found.what}{f': {said}' if said else ''}"


def imu_place(made: Proposal, ask: Ask, given: str) -> tuple[str, ...]:
    """Where the accelerometers are, each length with its unit; none where nobody says. Raises UsageError for a `given`
    one that is no place."""
    device = made.signals().get("az")
    if given:
        return _place(given)
    question = f"accelerometers of {device}: {WHERE}"
    while device is not None and (answer := ask(question)):
        try:
            return _place(answer)
        except UsageError as error:
            question = str(error)
    return ()


def _place(text: str) -> tuple[str, ...]:
    """Raises UsageError."""
    lengths = tuple(word.strip() for word in text.split(","))
    kind: Any = Rig.model_fields["imu_position"].annotation
    try:
        TypeAdapter[Any](kind).validate_python(lengths)
    except ValidationError as error:
        why = error.errors()[0]["msg"]
        raise UsageError(f"{text}: {why}\nforward, right, down from the centre of gravity, like {PLACE}") from error
    return lengths


# --- the files


def rig_text(name: str, made: Proposal, ports: Mapping[str, str], imu: tuple[str, ...] = ()) -> str:
    """The rig's TOML. `ports`: address heard -> what the rig calls it; `imu`: where the accelerometers are, if told."""
    where = ", ".join(f'"{length}"' for length in imu or ("0 m",) * 3)
    doubt = "" if imu else " To be measured."
    lines = [
        "# Proposed from what was heard: look at each line before it is flown. Keys: profiles/README.md.",
        "",
        f'name = "{name}"',
        'description = "Proposed by station rig new"',
        f"imu_position = [{where}] # from the centre of gravity: forward, right, down.{doubt}",
    ]
    for device, found, streams in made.devices:
        lines += ["", *_comments(made.passed_over[device])]
        if not any(streams.values()):
            lines += [f"# {describe(found)}: {unused(found)}"]
            continue
        lines += ["[[devices]]", f'name = "{device}"', f'link = "{found.link}"', *_address(found, ports)]
        for message, channels in streams.items():
            if channels:
                lines += _stream(message, _rate(found, message), channels)
    return "\n".join(lines) + "\n"


def unused(found: Heard) -> str:
    """Why a device is not in the rig."""
    if found.protocol in UNNAMED:
        return "not in the rig: nothing that it sends says what its fields are; --map v0=alpha_vane:deg:0.005 does"
    return "gives no signal that is not had elsewhere"


def _comments(passed_over: Sequence[str]) -> list[str]:
    return [f"# not used: {words}" for words in passed_over]


def _address(found: Heard, ports: Mapping[str, str]) -> list[str]:
    address = ports.get(found.address, found.address)
    if found.link == "serial":
        return [f'protocol = "{found.protocol}"', f'port = "{address}"', f"baud = {found.baud}"]
    if found.link == "mavlink":
        return [f'url = "{address}"']
    interface, _, channel = address.partition(":")
    return [f'interface = "{interface}"', f'channel = "{channel}"']


def _stream(message: str | int, rate: int, channels: Mapping[str, Channel]) -> list[str]:
    title = re.sub(r"[^a-z0-9]+", "_", str(message).rpartition(".")[2].lower()).strip("_")
    called = f"message_{title}" if isinstance(message, int) else title
    shown = message if isinstance(message, int) else f'"{message}"'
    lines = ["", "[[devices.streams]]", f'name = "{called}"', f"message = {shown}", f'rate = "{rate} Hz" # as heard']
    lines += ["[devices.streams.signals]"]
    for signal, c in channels.items():
        words = [f'field = "{c.field}"', f'unit = "{c.unit}"']
        words += [
            f"{key} = {value!r}" for key, value in (("slope", c.slope), ("zero", c.zero)) if value != (key == "slope")
        ]
        words += [f"noise = {c.noise:g}"] if c.noise else []
        caveat = CAVEATS.get((str(message), signal), SIGNALS[signal].positive)
        lines.append(f"{signal} = {{ {', '.join(words)} }} # {caveat}")
    return lines


def card_text(name: str, aircraft: str, made: Proposal) -> str:
    """A card that flies the rig with that aircraft."""
    usual_needs = Card.model_fields["needs"].default
    given = made.signals()
    needs = ", ".join(f'"{n}"' for n in usual_needs if n in given)
    lacking = [n for n in usual_needs if n not in given]
    told = [f"# No device gives {', '.join(lacking)}: what needs them is not estimated."] if lacking else []
    return "\n".join(
        [f'name = "{name}"', 'description = "Proposed by station rig new"', f'aircraft = "{aircraft}"',
         f'rig = "{name}"', *told, f"needs = [{needs}]"]
    ) + "\n"  # fmt: skip
