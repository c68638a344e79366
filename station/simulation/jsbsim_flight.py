"""Flights of JSBSim's DHC-6: an aircraft that nobody here wrote, seen through our boom and sensors.

JSBSim flies in the air mass; boom, upwash, vane and imu are the profile's, test inputs the card's, gusts our frozen
field's. JSBSim has one wind, that at the CG: its tail meets a gust with its wing, the vane ahead of both. A pilot holds
speed and height with slow power, wings and heading with ailerons: the model is none too stable about the roll axis.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from station.conventions import to_si
from station.profile import NO_BOOM, Actuator, Aircraft, Flight, Manoeuvre, Order, Pilot
from station.rows import ProfileError
from station.simulation import longitudinal as eq
from station.simulation.airframe import HOLD_HEIGHT, HOLD_LAG, HOLD_SPEED, indicial_tables
from station.simulation.boom import vane_constants
from station.simulation.flown_aircraft import elevator_backlash, site
from station.simulation.gusts import dryden_of, gust_at
from station.simulation.legs import ORIGIN, without_legs
from station.simulation.manoeuvres import surface_input
from station.simulation.motion import DONE, DT, EVERY, FLOWN, memory_of, tip_now
from station.simulation.pilot import asked, hands
from station.simulation.sensors import lagged
from station.simulation.three_degrees import HANDS_OFF, line_of, tremor
from station.simulation.truth import TRUTH

MODEL: Final = "DHC6"
FINER: Final = 4
"""JSBSim's steps in one of ours: it integrates with the accelerations of the step before."""
_FT, _KNOT, _POUND, _SLUG, _PSF = (to_si(1.0, unit) for unit in ("ft", "kt", "lbf", "slug", "psf"))
_BLOCK: Final = 400
_BEHIND: Final = 2.0
"""Gusts are kept so far behind the CG, m."""
SETTLING_S: Final = 60.0
_TRAVEL: Final = {"elevator": (0.454, 0.244), "aileron": (0.33, 0.28), "rudder": (0.28, 0.28)}
"""rad to the negative and to the positive side, as JSBSim's FCS has them; ours: aileron positive rolls left."""
_COMMANDS: Final = {"elevator": ("elevator", "pitch-trim", 1.0), "aileron": ("aileron", "roll-trim", -1.0),
                    "rudder": ("rudder", "yaw-trim", 1.0)}  # fmt: skip
_POSITIONS: Final = {"elevator": "fcs/elevator-pos-rad", "aileron": "fcs/left-aileron-pos-rad",
                     "rudder": "fcs/rudder-pos-rad"}  # fmt: skip
_READ: Final[Mapping[str, tuple[str, float]]] = {
    "u": ("velocities/u-fps", _FT), "v": ("velocities/v-fps", _FT), "w": ("velocities/w-fps", _FT),
    "p": ("velocities/p-rad_sec", 1.0), "q": ("velocities/q-rad_sec", 1.0), "r": ("velocities/r-rad_sec", 1.0),
    "pdot": ("accelerations/pdot-rad_sec2", 1.0), "qdot": ("accelerations/qdot-rad_sec2", 1.0),
    "rdot": ("accelerations/rdot-rad_sec2", 1.0),
    "phi": ("attitude/phi-rad", 1.0), "theta": ("attitude/theta-rad", 1.0), "psi": ("attitude/psi-rad", 1.0),
    "v_north": ("velocities/v-north-fps", _FT), "v_east": ("velocities/v-east-fps", _FT),
    "v_down": ("velocities/v-down-fps", _FT), "altitude": ("position/h-sl-ft", _FT),
    "airspeed": ("velocities/vt-fps", _FT), "dynamic_pressure": ("aero/qbar-psf", _PSF),
    "static_pressure": ("atmosphere/P-psf", _PSF), "air_temperature": ("atmosphere/T-R", 5 / 9),
    "alpha": ("aero/alpha-rad", 1.0), "mass": ("inertia/mass-slugs", _SLUG),
    "fx": ("forces/fbx-total-lbs", _POUND), "fy": ("forces/fby-total-lbs", _POUND),
    "fz": ("forces/fbz-total-lbs", _POUND),
    "aero_x": ("forces/fbx-aero-lbs", _POUND), "aero_z": ("forces/fbz-aero-lbs", _POUND),
    "moment": ("moments/m-aero-lbsft", _POUND * _FT),
    "left": ("propulsion/engine[0]/thrust-lbs", _POUND), "right": ("propulsion/engine[1]/thrust-lbs", _POUND),
}  # fmt: skip
_NO_FLOW: Final = eq.Flow(*(math.nan for _ in eq.Flow._fields))
_PILOT_SEES: Final = ("airspeed", "altitude", "phi", "psi", "p", "r")

# The pilot: power as the longitudinal simulation's thrust; ailerons for the wings, rad per rad and per rad/s.
_BANK, _ROLL, _HEADING, _TURN_LIMIT, _YAW = 0.4, 0.2, 1.0, 0.1, 0.1


def _load() -> Any:
    """The package, made to leave standard output alone. Raises ProfileError where it is not installed."""
    try:
        import jsbsim
    except ImportError:
        raise ProfileError(
            'flight.source: "jsbsim" needs a package that is not installed\ninstall it: pip install "jsbsim>=1.2,<2"'
        ) from None
    package: Any = jsbsim
    package.FGJSBBase().debug_lvl = 0
    if hasattr(package, "FGLogger"):
        names = ("file_location", "flush", "format", "message", "set_level")
        package.set_logger(type("Silent", (package.FGLogger,), dict.fromkeys(names, lambda *_: None))())
    return package


def trimmed(speed: float, height: float, heading: float = 0.0, dt: float = DT / FINER) -> Any:
    """JSBSim's DHC-6 in steady flight at a true airspeed (m/s) and height (m). Raises ProfileError."""
    jsbsim = _load()
    sim = jsbsim.FGFDMExec(None)
    sim.set_debug_level(0)
    if not sim.load_model(MODEL):
        raise ProfileError(f'flight.source: "jsbsim": the installed jsbsim has no aircraft {MODEL}')
    sim.set_dt(dt)
    place = {"ic/lat-geod-deg": math.degrees(ORIGIN[0]), "ic/long-gc-deg": math.degrees(ORIGIN[1])}
    settings = place | {
        "ic/h-sl-ft": height / _FT,
        "ic/vt-kts": speed / _KNOT,
        "ic/psi-true-deg": math.degrees(heading),
    }
    for engine in (0, 1):
        settings |= {f"fcs/throttle-cmd-norm[{engine}]": 0.5, f"fcs/mixture-cmd-norm[{engine}]": 0.9}
        settings |= {f"fcs/advance-cmd-norm[{engine}]": 1.0}
    for name, value in (settings | {"propulsion/set-running": -1}).items():
        sim[name] = value
    try:
        sim.run_ic()
        sim.do_trim(1)
    except RuntimeError as error:  # jsbsim.TrimFailureError among them
        raise ProfileError(f"JSBSim's {MODEL}: no trim at {speed:.1f} m/s, {height:.0f} m ({error})") from None
    sim["propulsion/fuel_freeze"] = 1
    return sim


class _Surface:
    """The command of a surface, through the profile's actuator and the backlash behind it, at DT."""

    def __init__(self, actuator: Actuator, at: float, backlash: float = 0.0) -> None:
        self._actuator = actuator
        self._state = np.array([at, at])
        self._half = 0.5 * backlash
        self.drive = at
        self.surface = at

    def move(self, command: float) -> None:
        """One step on; the command goes straight from the last one."""
        a, before = self._actuator, self._state[0]
        lagged(np.array([command]), self._state, DT / a.time_constant)
        most = a.rate_limit * DT
        self._state[0] = min(max(self._state[0], before - most), before + most)
        self.drive = min(max(float(self._state[0]), -a.position_limit), a.position_limit)
        self.surface = min(max(self.surface, self.drive - self._half), self.drive + self._half)


class JsbsimFlight:
    """As `Simulation`, flown by JSBSim: rows at 200 Hz with every signal of FLOWN, and TRUTH.

    It begins within 1 % of the flight's speed and 10 m of its altitude.
    """

    def __init__(
        self,
        aircraft: Aircraft,
        flight: Flight,
        manoeuvres: Sequence[Manoeuvre] = (),
        imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0),
        seed: int | None = None,
        pilot: Pilot = HANDS_OFF,
    ) -> None:
        """As Simulation's. Raises ProfileError."""
        self._sim = trimmed(flight.speed, flight.altitude, flight.heading)
        self._flight = flight
        self._manoeuvres = tuple(manoeuvres)
        self._asked: tuple[Manoeuvre, ...] = ()
        self._imu = np.array(imu_position)
        boom, unsteady = aircraft.boom or NO_BOOM, aircraft.unsteady
        self._vane, self._second = vane_constants(boom, DT), vane_constants(aircraft.second_vane, DT)
        self._tables = indicial_tables(aircraft)
        self._chord = unsteady.reference_chord or aircraft.geometry.chord
        self._nose = aircraft.gust_edge
        self._ahead = max(boom.gust_x, self._second.gust_x, self._nose) + 1.0
        self._site = site(flight, imu_position)
        self._field = line_of(flight, _BEHIND, self._ahead, seed)
        self._is_windy = dryden_of(flight).sigma_w > 0
        self._tremor = tremor(flight, pilot, seed)
        actuators = {"elevator": aircraft.elevator, "aileron": aircraft.aileron, "rudder": aircraft.rudder}
        self._trim = {name: _COMMANDS[name][2] * float(self._sim[_POSITIONS[name]]) for name in actuators}
        backlashes = {"elevator": elevator_backlash(aircraft)}
        self._surfaces = {n: _Surface(a, self._trim[n], backlashes.get(n, 0.0)) for n, a in actuators.items()}
        self._power = [float(self._sim[f"fcs/throttle-cmd-norm[{i}]"]) for i in (0, 1)]
        self._thrust = max(1.0, sum(float(self._sim[_READ[n][0]]) * _POUND for n in ("left", "right")))
        self._held = 0.0
        self._inputs: dict[str, NDArray[np.float64]] = {}
        self._way = np.zeros(2)
        """North and east through the air mass, m."""
        self._distance = 0.0
        self._now = self._state()
        self._settle()
        self._hands = hands(pilot, self._now["theta"], self._now["altitude"], flight.speed)
        self._memory = memory_of(np.zeros(eq.LAGS), 1, self._tables, 0.0, self._hands)

    def advance(self, n: int) -> dict[str, NDArray[np.float64]]:
        """The next `n` instants at 200 Hz: "time" (s of flight), every signal true in SI, and TRUTH; each (n,)."""
        names = (*FLOWN, *TRUTH)
        out = np.empty((len(names), n))
        begin = int(self._memory.marks[DONE])
        for k in range(n):
            row = self._row()
            out[:, k] = [row[name] for name in names]
            self._step()
        return {"time": (begin + np.arange(n, dtype=np.float64)) * DT, **dict(zip(names, out, strict=True))}

    def _settle(self) -> None:
        """Fly in still air until the engines, which JSBSim starts at idle whatever its trim says, are where it was."""
        self._sim.set_dt(DT)
        for _ in range(round(SETTLING_S / DT)):
            for name, angle in self._piloted().items():
                self._surfaces[name].move(angle)
                self._deflect(name, self._surfaces[name].surface)
            self._sim.run()
            self._now |= {name: float(self._sim[_READ[name][0]]) * _READ[name][1] for name in _PILOT_SEES}
        self._sim.set_dt(DT / FINER)
        self._blow()
        self._sim.run()
        self._now = self._state()

    def _state(self) -> dict[str, float]:
        sim = self._sim
        return {name: float(sim[place]) * scale for name, (place, scale) in _READ.items()}

    def _gust(self, metres: float) -> tuple[float, float, float]:
        """u_g, v_g, w_g that far ahead of the CG, m/s."""
        at = self._distance + metres
        return tuple(float(gust_at(self._field.now, at, i)) for i in range(3))  # type: ignore[return-value]

    def _row(self) -> dict[str, float]:
        """All there is to know now."""
        s, m, v = self._now, self._memory, self._vane
        time = int(m.marks[DONE]) * DT
        inertial = math.atan2(s["w"], s["u"])
        ug, _, wg = self._gust(self._nose)
        force = np.array([s["fx"], s["fy"], s["fz"]]) / s["mass"]
        m.x[eq.U], m.x[eq.W], m.x[eq.Q], m.x[eq.DISTANCE] = s["u"], s["w"], s["q"], self._distance
        moving = (s["qdot"], s["v"] + s["r"] * v.x - s["p"] * v.z, s["p"])
        flow = _NO_FLOW._replace(
            airspeed=s["airspeed"],
            pressure=s["dynamic_pressure"],
            force_z=float(force[2]),
            alpha_inertial=inertial,
            gust_edge=math.atan2(s["w"] + wg, s["u"] + ug) - inertial,
        )
        tip = tip_now(self._chord, self._tables, (v, self._second), m, self._field.now, moving, flow)
        spin, turn = np.array([s["p"], s["q"], s["r"]]), np.array([s["pdot"], s["qdot"], s["rdot"]])
        felt = force + np.cross(turn, self._imu) + np.cross(spin, np.cross(spin, self._imu))
        place, flight = self._site, self._flight
        north, east = self._way + np.array([flight.wind_north, flight.wind_east]) * time
        latitude = place.latitude + north / place.radius_north
        u_gust, _, w_gust = self._gust(0.0)
        sin, cos, geometry = math.sin(s["alpha"]), math.cos(s["alpha"]), self._sim
        load = s["dynamic_pressure"] * float(geometry["metrics/Sw-sqft"]) * _FT**2
        return s | {
            "alpha_vane": tip[0], "beta_vane": tip[1], "az_boom": tip[2], "alpha_vane_2": tip[3],
            "ax": felt[0], "ay": felt[1], "az": felt[2],
            "v_north": s["v_north"] + flight.wind_north, "v_east": s["v_east"] + flight.wind_east,
            "latitude": latitude,
            "longitude": place.longitude
            + east / (place.radius_east * math.cos(0.5 * (latitude + place.latitude))),
            "psi": math.remainder(s["psi"], 2 * math.pi), "thrust": s["left"] + s["right"],
            "elevator": self._surfaces["elevator"].surface, "aileron": self._surfaces["aileron"].surface,
            "rudder": self._surfaces["rudder"].surface, "elevator_drive": self._surfaces["elevator"].drive,
            "alpha_inertial": inertial, "alpha_gust": s["alpha"] - inertial, "w_gust": w_gust, "u_gust": u_gust,
            "CL": (s["aero_x"] * sin - s["aero_z"] * cos) / load,
            "Cm": s["moment"] / (load * float(geometry["metrics/cbarw-ft"]) * _FT),
        }  # fmt: skip

    def _step(self) -> None:
        """Controls and gusts as they will be DT later, JSBSim as far."""
        s, sim, k = self._now, self._sim, int(self._memory.marks[DONE])
        before = {n: part.surface for n, part in self._surfaces.items()}
        commands = self._commands(k)
        for name, part in self._surfaces.items():
            part.move(commands[name])
        heading = self._flight.heading
        self._field.cover(self._distance - 1.0, self._distance + self._ahead + 10.0)
        along = s["v_north"] * math.cos(heading) + s["v_east"] * math.sin(heading)
        begin = self._distance
        for j in range(1, FINER + 1):
            part_done = j / FINER
            self._distance = begin + along * DT * part_done
            for name, surface in self._surfaces.items():
                self._deflect(name, before[name] + part_done * (surface.surface - before[name]))
            self._blow()
            sim.run()
        self._now = self._state()
        new = self._now
        velocity = 0.5 * np.array([s["v_north"] + new["v_north"], s["v_east"] + new["v_east"]])
        self._way = self._way + velocity * DT
        self._distance = begin + float(velocity @ np.array([math.cos(heading), math.sin(heading)])) * DT
        self._memory.marks[DONE] += 1

    def ask(self, manoeuvres: Sequence[Order]) -> None:
        """As Simulation's, from the next block of inputs on."""
        self._asked = tuple(without_legs(manoeuvres))

    def _commands(self, k: int) -> dict[str, float]:
        """What the pilot asks for at the end of step k, rad; sets the power too."""
        number, at = divmod(k + 1, _BLOCK)
        if at == 0 or not self._inputs:
            time = (np.arange(_BLOCK, dtype=np.float64) + number * _BLOCK) * DT
            self._inputs = {
                n: surface_input(self._manoeuvres, time, n) + surface_input(self._asked, time, n)
                for n in self._surfaces
            }
            self._inputs["elevator"] += self._tremor.half_steps(_BLOCK // EVERY)[: 2 * _BLOCK : 2]
        pilot, s = self._piloted(), self._now
        pilot["elevator"] += asked(self._hands, self._memory.asked, k, s["q"], s["theta"], s["altitude"], s["airspeed"])
        return {n: angle + float(self._inputs[n][at]) for n, angle in pilot.items()}

    def _piloted(self) -> dict[str, float]:
        """Where the pilot alone wants the surfaces, rad; sets the power."""
        s, flight = self._now, self._flight
        wanted = HOLD_SPEED * (flight.speed - s["airspeed"]) + HOLD_HEIGHT * (flight.altitude - s["altitude"])
        self._held += (wanted * s["mass"] / self._thrust - self._held) * DT / HOLD_LAG
        for i, power in enumerate(self._power):
            self._sim[f"fcs/throttle-cmd-norm[{i}]"] = min(max(power * (1 + self._held), 0.0), 1.0)
        turned = math.remainder(s["psi"] - flight.heading, 2 * math.pi)
        level = s["phi"] + min(max(_HEADING * turned, -_TURN_LIMIT), _TURN_LIMIT)
        pilot = {"elevator": 0.0, "aileron": _BANK * level + _ROLL * s["p"], "rudder": _YAW * s["r"]}
        return {n: self._trim[n] + angle for n, angle in pilot.items()}

    def _deflect(self, name: str, angle: float) -> None:
        down, up = _TRAVEL[name]
        command, trim, sign = _COMMANDS[name]
        share = sign * angle / (up if angle > 0 else down)
        self._sim[f"fcs/{command}-cmd-norm"] = share - self._sim[f"fcs/{trim}-cmd-norm"]

    def _blow(self) -> None:
        """The gust at the CG, of body axes, as the wind that JSBSim takes."""
        if not self._is_windy:
            return
        ug, vg, wg = self._gust(0.0)
        s = self._now
        sin_b, cos_b = math.sin(s["phi"]), math.cos(s["phi"])
        sin_t, cos_t = math.sin(s["theta"]), math.cos(s["theta"])
        sin_h, cos_h = math.sin(s["psi"]), math.cos(s["psi"])
        # A gust adds to the velocity relative to the air: the air moves the other way.
        level, right = ug * cos_t + (vg * sin_b + wg * cos_b) * sin_t, vg * cos_b - wg * sin_b
        down = -ug * sin_t + (vg * sin_b + wg * cos_b) * cos_t
        self._sim["atmosphere/gust-north-fps"] = -(level * cos_h - right * sin_h) / _FT
        self._sim["atmosphere/gust-east-fps"] = -(level * sin_h + right * cos_h) / _FT
        self._sim["atmosphere/gust-down-fps"] = -down / _FT
