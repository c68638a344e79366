"""What an aircraft is: geometry, mass, boom, derivatives, what is unsteady about it."""

from __future__ import annotations

import math
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from station.conventions import G0, SIGNALS
from station.profile.fin import Fin
from station.profile.outline import Planform
from station.profile.propulsion import Engine
from station.profile.quantity import (
    Frozen,
    Hertz,
    KilogramMetres2,
    Kilograms,
    Metres,
    MetresPerSecond,
    Positive,
    Radians,
    RadiansPerSecond,
    Seconds,
    SquareMetres,
    nearest,
    quantity,
)
from station.profile.told_by_flight import Calibrated, Measured
from station.profile.uncertainty import Uncertainty


class Derivative(Frozen):
    """A coefficient, per radian (rates normalised), its prior standard deviation in the same unit, and its source."""

    value: float
    """The coefficient."""
    sd: float | None = Field(default=None, ge=0)
    """Its prior standard deviation: 0 where it is known exactly; where left out, diagnosis takes 10 % of the value."""
    source: str = ""
    """Where it is from."""


class Geometry(Frozen):
    wing_area: Annotated[SquareMetres, Positive]
    """Reference area of every coefficient."""
    span: Annotated[Metres, Positive]
    """Reference length of Cl, Cn, p b/2V and r b/2V."""
    chord: Annotated[Metres, Positive]
    """Mean aerodynamic or geometric chord: the reference length of Cm and of q c/2V."""


class Inertia(Frozen):
    mass: Annotated[Kilograms, Positive]
    """All-up mass, at the beginning of a recording that has the fuel flow and no mass; a recorded one takes
    precedence."""
    ixx: Annotated[KilogramMetres2, Positive] | None = None
    """Roll inertia about the CG; needed for Cl and Cn."""
    iyy: Annotated[KilogramMetres2, Positive] | None = None
    """Pitch inertia; needed for Cm."""
    izz: Annotated[KilogramMetres2, Positive] | None = None
    """Yaw inertia; needed for Cl and Cn."""
    ixz: KilogramMetres2 = 0.0
    """Product of inertia."""


MOST_TERMS: Final = 8
"""Of an indicial response."""


class Indicial(Frozen):
    """phi(t) = 1 - sum a exp(-b t), t in chords travelled (physics of unsteady lift and upwash)."""

    a: tuple[float, ...]
    """Amplitudes."""
    b: tuple[float, ...]
    """Rates, per reference chord travelled."""

    @model_validator(mode="before")
    @classmethod
    def _lists(cls, raw: Any) -> Any:
        return {k: tuple(v) if isinstance(v, list) else v for k, v in raw.items()} if isinstance(raw, dict) else raw

    @model_validator(mode="after")
    def _same_length(self) -> Self:
        if len(self.a) != len(self.b) or not self.a or min(self.b) <= 0:
            raise PydanticCustomError("indicial", "a and b need the same number of terms, every b above 0")
        if len(self.a) > MOST_TERMS:
            raise PydanticCustomError("indicial", f"at most {MOST_TERMS} terms")
        return self


class Boom(Frozen):
    """The boom and its vane, on the nose or, with `vane_y`, on a wing's tip. Of the upwash, the body's part is
    quasi-steady and the wing's unsteady."""

    vane_x: Metres
    """Vane ahead of the CG, positive forward."""
    vane_y: Metres = 0.0
    """Vane right of the CG."""
    vane_z: Metres = 0.0
    """Vane below the CG."""
    upwash_body: float = Field(default=0.0, ge=-0.5, le=1.0)
    """Upwash angle at the vane per angle of attack that fuselage and boom cause, without memory."""
    upwash_wing: float = Field(default=0.0, ge=-0.5, le=1.0)
    """The same of the wing, whose circulation follows the angle of attack late. k_u0 is the sum of both."""
    upwash_roll: float = Field(default=0.0, ge=-0.5, le=1.0)
    """The same of the wing's rolling, per flow angle p y/V at the vane; flown by simulations, unknown to estimators."""
    sidewash: float = Field(default=0.0, ge=-0.5, le=1.0)
    """Sidewash angle at the beta vane per flow angle there; simulations fly it, estimators take it for a gain."""
    zero: Radians = 0.0
    """Vane reading at zero flow angle."""
    vane_frequency: Annotated[Hertz, Positive] = 9.0
    """Natural frequency of the vane on its spring of air."""
    vane_damping: float = Field(default=0.35, gt=0, lt=2)
    """Damping ratio of the vane."""
    flexure: Annotated[float, quantity("rad s2/m")] = 0.0
    """Vane angle per specific force down: positive where the boom droops when pulled up."""
    tip_load: float = Field(default=0.0, ge=-1.0, le=1.0)
    """Vane angle by which the boom bends per flow angle, for each kPa of dynamic pressure."""
    mode_frequency: Annotated[Hertz, Positive] | None = None
    """Of the boom's first bending mode; without one it bends at once."""
    mode_damping: float = Field(default=0.03, gt=0, lt=2)
    """Damping ratio of that mode."""
    mode_length: Metres = 0.0
    """How far the vane rises per radian of bending: about 2/3 of a slender boom's length."""
    mode_turn: float = Field(default=1.0, ge=-1.0, le=1.0)
    """Share of the bending that turns the vane: 1 of a boom; of a wing less the sine of its sweep, as bending up
    takes incidence from tips that are swept aft."""
    gust_lead: float = Field(default=1.0, ge=0, le=4)
    """How far ahead of the CG a gust meets the vane, in vane_x."""

    @property
    def gust_x(self) -> float:
        """Where a gust meets the vane, ahead of the CG, m."""
        return self.vane_x * self.gust_lead

    @property
    def steady_calibration(self) -> float:
        """Flow angle over vane angle when steady: 1/(1 + k_u0)."""
        return 1.0 / (1.0 + self.upwash_body + self.upwash_wing)


AVERAGED_ALONE: Final = (
    '[second_vane] averaged: no second vane is shown (measures = "alpha_vane", position, of the rig\'s [signals.NAME]):'
    " alpha_vane is the first alone"
)
"""Of a rig or a recording."""


class SecondVane(Boom):
    """A further vane of the angle of attack, on a wing's tip or elsewhere. A rig's signal that `measures =
    "alpha_vane"` shows it; emulated it is `alpha_vane_2`."""

    averaged: bool = False
    """Whether the mean of both vanes, each brought to the first one's place, stands for it while they agree."""


NO_BOOM: Final = Boom.model_validate({"vane_x": "0 m"})
"""For an aircraft without one: a vane at the CG, without upwash."""


class Unsteady(Frozen):
    """How lift, downwash and upwash lag behind the motion and the gust (thin wing with a tail)."""

    memory: bool = True
    """False: quasi-steady lift, which wing and tail make of what the CG meets; the upwash at the boom keeps its own."""
    tail_lift_slope: float = Field(default=0.0, ge=0)
    """Tail's share of CL_alpha, per rad, referred to the wing area (a_h)."""
    tail_arm: Metres = 0.0
    """Tail's aerodynamic centre behind the CG."""
    tail_span: Metres = Field(default=0.0, ge=0)
    """Of the tail, along which it averages gusts in a card's `field = "plane"`."""
    tail_penetration: float = Field(default=1.0, ge=0, le=4)
    """How far behind the CG a gust meets the tail, in tail arms: 0 as if the tail were at the CG."""
    downwash: float = Field(default=0.0, ge=0, lt=1)
    """d epsilon / d alpha (e)."""
    downwash_delay: Seconds = 0.0
    """How much later than tail_arm/V the downwash reaches the tail."""
    reference_chord: Annotated[Metres, Positive] | None = None
    """Chord that the times of the indicial responses are counted in; the geometry's if left out."""
    gust_span: Metres = Field(default=0.0, ge=0)
    """Length of the lag by which the wing averages gusts along its span: about a quarter of it; 0 for none."""
    gust_span_shape: float = Field(default=1.0, gt=0, le=1)
    """How that lag spreads, its variance as a share of that of lags which thin out from the first on: 1 as a lag of the
    first order does, or where strips of a span are met one after the other (`gust_span_cut` 1/2); 3/4 with an elliptic
    loading. Of diagnosis: simulations take 1."""
    gust_span_cut: float = Field(default=0.0, ge=0, le=0.5)
    """That lag's mean over the longest one: 1/2 where a span meets gusts evenly on either side of the mean, 0 for no
    longest. Of diagnosis: simulations take 0."""
    gust_span_tail: Metres = Field(default=0.0, ge=0)
    """The same of the tail."""
    turned_at_once: float = Field(default=0.5, ge=0, le=1)
    """Share of the mean angle of attack that a gust along the path turns at once, at wing and tail when it meets them;
    the rest is followed as a gust across the path is, late and averaged. Of diagnosis."""
    gust_speed: float = Field(default=1.0, ge=0, le=1)
    """How the angle of a gust across the path follows the airspeed from vane to wing: 1 as that of a velocity which
    stays the same, 0 not at all. Of diagnosis."""
    gust_tilt: float = Field(default=0.5, ge=0, le=1)
    """How gusts across the path lie to it, over the angle of attack: 0 square to the path, as in isotropic turbulence,
    1 square to the body's axis, as simulations have them that add them to w. The airspeed rises with an updraught by
    the sine of that. Of diagnosis."""
    tail_speed: float = Field(default=1.0, ge=0, le=2)
    """How the tail's lift in gusts follows the speed of the air there in place of that at the CG: 2 with the square of
    it over the other, as a surface alone in that air would; 0 not at all. Of diagnosis."""
    speed_gusts: float = Field(default=0.5, ge=0, le=1)
    """How much of the airspeed's changes in short gusts `CL_V`, `Cm_V` and `CD_V` follow: 0 none of gusts that are
    shorter than five spans, for a span meets but their mean; 1 all of them. Of diagnosis."""
    gust_turning: float = 0.375
    """How much air turns about the vertical where a side gust changes along the path, rad/s over its rate of change
    in sideslip: 3/8 in isotropic turbulence, by continuity, 0 of gusts that are the same along the span. Of
    diagnosis."""
    convection: float = Field(default=1.0, ge=0, le=1)
    """Share of a change of speed that the transit times of gusts and wakes follow: 1 where they stand frozen in the
    air, 0 where they pass as at the mean speed."""
    lift_motion: Indicial | None = None
    """Wing's lift after a step of the angle of attack (Wagner's function where the wing is thin)."""
    lift_gust: Indicial | None = None
    """Wing's lift after entering a sharp-edged gust (Kuessner's function)."""
    upwash_motion: Indicial | None = None
    """Wing's upwash at the vane after a step of the angle of attack."""
    upwash_gust: Indicial | None = None
    """Wing's upwash at the vane after entering a sharp-edged gust."""


class Separation(Frozen):
    """How the flow leaves the wing: of the wing's CL_alpha (alpha - alpha_0), ((1 + sqrt X)/2)^2 is left, where X, the
    share of the chord with attached flow, is 0.5 (1 - tanh(a1 (alpha - tau2 c/V alphadot - alpha_star))) behind a lag
    of tau1 c/V (Kirchhoff; Goman and Khrabrov 1994); while alpha rises, tau2_rising for tau2."""

    alpha_star: Radians | None = None
    """Angle of attack at which the flow has left half of the chord; without one it stays attached."""
    alpha_0: Radians = 0.0
    """Angle of attack at which attached flow does not lift; below the reference line with a wing set or cambered."""
    a1: Annotated[float, Positive] = 20.0
    """How sharply it does, per rad."""
    tau1: float = Field(default=10.0, ge=0)
    """Lag of X, in chords travelled."""
    tau2: float = Field(default=10.0, ge=0)
    """How much later the flow comes back, in chords travelled: counts while the angle of attack falls."""
    tau2_rising: float = Field(default=0.0, ge=0)
    """How much later it leaves: counts while the angle of attack rises; in Goman's and Khrabrov's own law as tau2."""
    CD_X: float = 0.0
    """Drag of separated flow: CD has CD_X (1 - X)."""
    Cm_X: float = 0.0
    """Pitching moment of separated flow: Cm has Cm_X (1 - X)."""


class Drag(Frozen):
    """CD = zero_lift + induced CL^2."""

    zero_lift: float = Field(ge=0)
    """CD at no lift."""
    induced: float = Field(default=0.0, ge=0)
    """CD per CL squared."""


class Actuator(Frozen):
    time_constant: Annotated[Seconds, Positive] = 0.08
    """First-order lag between command and surface."""
    rate_limit: Annotated[RadiansPerSecond, Positive] = math.radians(60)
    """Fastest deflection."""
    position_limit: Annotated[Radians, Positive] = math.radians(20)
    """Largest deflection, either way."""


class Instrument(Frozen):
    """What a signal's sensor does to it besides its noise, as found in flight; SI of the signal.

    Reported = gain * lagged(signal + cubic signal^3, latency earlier) + bias; a surface's backlash lies between sensor
    and surface.
    """

    latency: Seconds = 0.0
    """Pure delay."""
    lag: Seconds = 0.0
    """Time constant of a first-order lag."""
    gain: float = Field(default=1.0, gt=0)
    """Reported over true: a scale error of 3 % is 1.03."""
    bias: float = 0.0
    """Reported at zero, in the signal's SI unit."""
    backlash: float = Field(default=0.0, ge=0)
    """Width of the backlash, in the signal's SI unit."""
    cubic: float = 0.0
    """Per square of the signal's SI unit."""


COEFFICIENTS = ("CL", "CD", "Cm", "CY", "Cl", "Cn")
ARGUMENTS = ("0", "V", "alpha", "alpha2", "alpha3", "q", "de", "beta", "p", "r", "da", "dr", "gust")
DERIVATIVE_NAMES = tuple(f"{c}_{a}" for c in COEFFICIENTS for a in ARGUMENTS)


class Aircraft(Frozen):
    name: str
    """What a card calls it."""
    description: str = ""
    """One sentence."""
    sources: tuple[str, ...] = ()
    """Where the numbers are from."""
    geometry: Geometry
    inertia: Inertia
    boom: Boom | None = None
    second_vane: SecondVane | None = None
    derivatives: dict[str, Derivative] = Field(default_factory=dict)
    """One table each, `[derivatives.CL_alpha]`: a coefficient of COEFFICIENTS, and what it multiplies, of ARGUMENTS."""
    rate_reference: Literal["instantaneous", "fixed"] = "instantaneous"
    """Whether rates are normalised with the speed of the instant or with the reference speed."""
    reference_speed: MetresPerSecond | None = None
    """For rate_reference = "fixed", and of CL_V."""
    air_density: Annotated[float, quantity("kg/m3")] | None = None
    """Fixed density; the standard atmosphere if left out."""
    thrust_angle: Radians = 0.0
    """Of the thrust line above the body's x axis."""
    thrust_pitch_arm: Metres = 0.0
    """Nose-up moment per newton of thrust, m."""
    drag: Drag | None = None
    engine: Engine | None = None
    unsteady: Unsteady = Unsteady(memory=False)
    fin: Fin | None = None
    planform: Planform | None = None
    separation: Separation = Separation()
    uncertainty: Uncertainty = Uncertainty()
    elevator: Actuator = Actuator()
    aileron: Actuator = Actuator()
    rudder: Actuator = Actuator()
    kinematics_only: bool = False
    """Geometry and mass are placeholders: instruments can be calibrated with such a profile, derivatives not found."""
    measured: Measured | None = None
    calibrated: Calibrated | None = None
    static_position: float = Field(default=0.0, gt=-1, lt=1)
    """Static pressure shown less true, over the dynamic pressure: the altimeter's position error. Simulations fly it;
    that of airspeed and dynamic pressure stands whole in [instruments], and the air's density takes no harm."""
    instruments: dict[str, Instrument] = Field(default_factory=dict)
    """Errors of sensors that the rig does not know of, by signal: diagnosis writes them, the simulation flies them."""
    imu_offset: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    """How far from the rig's place the imu is, body axes."""

    @property
    def gust_edge(self) -> float:
        """How far ahead of the CG, at a quarter of the chord, the wing meets a gust, m: its leading edge, where its
        responses to gusts begin; without such, the CG."""
        is_unsteady = self.unsteady.lift_gust or self.unsteady.upwash_gust
        return self.geometry.chord / 4 if is_unsteady else 0.0

    @model_validator(mode="before")
    @classmethod
    def _sources(cls, raw: Any) -> Any:
        if isinstance(raw, dict):
            keys = ("sources", "imu_offset")
            raw = {k: tuple(v) if k in keys and isinstance(v, list) else v for k, v in raw.items()}
        return raw

    @model_validator(mode="after")
    def _known_derivatives(self) -> Self:
        for name in self.instruments:
            if name not in SIGNALS:
                raise PydanticCustomError(
                    "signal", "unknown signal {name}{near}", {"name": name, "near": nearest(name, tuple(SIGNALS))}
                )
        for name in self.derivatives:
            if name.lower().endswith(("dot", "alphadot", "alpha_dot")):
                raise PydanticCustomError(
                    "derivative",
                    "{name}: there are no such terms: where [unsteady] describes the tail, it makes them; else add "
                    "{name} to {rate}",
                    {"name": name, "rate": f"{name[:2]}_q"},
                )
            if name not in DERIVATIVE_NAMES:
                raise PydanticCustomError(
                    "derivative",
                    "unknown derivative {name}{near}",
                    {"name": name, "near": nearest(name, DERIVATIVE_NAMES)},
                )
        return self

    @property
    def most_thrust(self) -> float:
        """N: of the engine's data, or else twice the weight: aerobatic models that hover at half throttle have that."""
        known = self.engine.most_thrust if self.engine is not None else None
        return known or 2.0 * self.inertia.mass * G0

    @property
    def bends(self) -> bool:
        """Whether its boom does."""
        return self.boom is not None and bool(self.boom.flexure or self.boom.tip_load)

    def imu_at(self, stated: tuple[float, float, float]) -> tuple[float, float, float]:
        """Where the imu is from the CG, body axes, m, by the rig's statement and what is known beyond it."""
        return (stated[0] + self.imu_offset[0], stated[1] + self.imu_offset[1], stated[2] + self.imu_offset[2])

    def value(self, name: str) -> float:
        """A derivative's value; 0 where the profile has none."""
        found = self.derivatives.get(name)
        return found.value if found else 0.0
