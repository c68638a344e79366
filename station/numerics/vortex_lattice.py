"""Unsteady vortex lattice of a thin wing: lift and induced velocities after a step of its angle of attack or a gust.

Rings of vortices on the wing and on a flat wake that stays where it was shed (Katz and Plotkin, Low-Speed
Aerodynamics, 2nd ed., 12.3 and 13.12), linear in the angles. Symmetric about the plane y = 0. x is counted downstream,
y to the right, z up; speed 1, so that time is way travelled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FAR: Final = 1e3
"""Semispans after which the wake of a steady wing ends: what lies behind adds 1e-6 to the downwash."""
_ON_THE_LINE: Final = 1e-12
"""Squared distance from a vortex's line, over its length's square, below which it induces nothing."""


@dataclass(frozen=True, slots=True)
class Lattice:
    """A wing's right half in panels: their corners, downstream and outboard."""

    x: Array
    """(chordwise + 1, spanwise + 1), m: front and rear of each panel, along each line of the stream."""
    y: Array
    """(spanwise + 1,), m, from 0 to the semispan."""

    @property
    def shape(self) -> tuple[int, int]:
        """Panels chordwise and spanwise."""
        return self.x.shape[0] - 1, self.x.shape[1] - 1

    @property
    def depth(self) -> Array:
        """Each panel's length in the stream, (chordwise, spanwise), m."""
        depth = np.diff(self.x, axis=0)
        return np.asarray((depth[:, 1:] + depth[:, :-1]) / 2)

    @property
    def area(self) -> float:
        """Of both halves, m2."""
        return float(2 * np.sum(self.depth * np.diff(self.y)))

    @property
    def step(self) -> float:
        """Way travelled from one row of the wake to the next: a panel of the mean chord, m."""
        return self.area / (2 * float(self.y[-1])) / self.shape[0]

    def rings(self) -> Array:
        """Corners of the vortex rings, a quarter of a panel behind the panels', (chordwise + 1, spanwise + 1), m."""
        depth = np.diff(self.x, axis=0)
        return np.asarray(self.x + 0.25 * np.vstack([depth, depth[-1:]]))

    def controls(self) -> tuple[Array, Array]:
        """Where the flow follows the wing, three quarters down each panel: x (chordwise, spanwise) and y, m."""
        middle = (self.x[:, 1:] + self.x[:, :-1]) / 2
        return middle[:-1] + 0.75 * np.diff(middle, axis=0), (self.y[1:] + self.y[:-1]) / 2


def trapezoid(span: float, root: float, tip: float, sweep: float, panels: tuple[int, int]) -> Lattice:
    """A straight-edged wing of these chords, m, its quarter chord swept by `sweep`, rad, and at x = 0 in the middle;
    panels get narrower towards the tip, as cosines do."""
    y = span / 2 * np.sin(np.linspace(0.0, np.pi / 2, panels[1] + 1))
    return _winged(y, root + (tip - root) * y / y[-1], sweep, panels[0])


def ellipse(span: float, root: float, panels: tuple[int, int]) -> Lattice:
    """A wing of elliptic chord with a straight quarter chord at x = 0; its tip is cut where the chord is a tenth."""
    y = span / 2 * np.sin(np.linspace(0.0, np.arccos(0.1), panels[1] + 1))
    return _winged(y, root * np.sqrt(1 - (2 * y / span) ** 2), 0.0, panels[0])


def _winged(y: Array, chord: Array, sweep: float, chordwise: int) -> Lattice:
    share = np.linspace(0.0, 1.0, chordwise + 1)[:, None]
    return Lattice(y * np.tan(sweep) + (share - 0.25) * chord, y)


def _upwash(points: Array, begin: Array, end: Array) -> Array:
    """Velocity up at `points` (n, 3) of unit vortices in the plane z = 0 from `begin` to `end` (m, 2): (n, m)."""
    ax, ay = points[:, None, 0] - begin[None, :, 0], points[:, None, 1] - begin[None, :, 1]
    bx, by = points[:, None, 0] - end[None, :, 0], points[:, None, 1] - end[None, :, 1]
    z2 = points[:, None, 2] ** 2
    lx, ly = (end - begin).T
    up = ax * by - ay * bx
    # |a x b|^2: z's part is z^2 times the vortex's length squared.
    length = lx * lx + ly * ly
    across = up * up + z2 * length
    along = (lx * ax + ly * ay) / np.sqrt(ax * ax + ay * ay + z2) - (lx * bx + ly * by) / np.sqrt(
        bx * bx + by * by + z2
    )
    is_off = across > _ON_THE_LINE * length * length
    return np.asarray(np.where(is_off, up * along / np.where(is_off, across, 1.0), 0.0) / (4 * np.pi))


def _of_rings(points: Array, x: Array, y: Array) -> Array:
    """Velocity up at `points` (n, 3) of unit rings between the corners x (rows + 1, columns + 1), y, and their mirror
    images: (n, rows, columns). A ring that pushes down inside lifts."""
    rows, columns = x.shape[0] - 1, x.shape[1] - 1
    corner = np.stack([x, np.broadcast_to(y, x.shape)], axis=-1)
    total = np.zeros((points.shape[0], rows, columns))
    for mirrored in (1.0, -1.0):
        seen = points * np.array([1.0, mirrored, 1.0])
        out = _upwash(seen, corner[:, :-1].reshape(-1, 2), corner[:, 1:].reshape(-1, 2))
        back = _upwash(seen, corner[:-1].reshape(-1, 2), corner[1:].reshape(-1, 2))
        out, back = out.reshape(-1, rows + 1, columns), back.reshape(-1, rows, columns + 1)
        total += out[:, :-1] - out[:, 1:] + back[:, :, 1:] - back[:, :, :-1]
    return total


@dataclass(frozen=True, slots=True)
class StepResponse:
    """What a wing does after a step of 1 rad, over way travelled; all tend to 1."""

    way: Array
    """Travelled since the step, m; of a gust since its edge met x = 0."""
    lift: Array
    """Over the steady lift; of a motion without the apparent mass, which is in the first instant alone."""
    upwash: Array
    """At each further point, (points, steps), over the steady one."""


@dataclass(frozen=True, slots=True)
class WingResponse:
    """A wing steady and after steps."""

    lift_slope: float
    """CL per rad, of the wing's own area."""
    upwash: Array
    """At each further point, steady, over the angle of attack; negative is a downwash."""
    motion: StepResponse
    """After a step of the angle of attack."""
    gust: StepResponse
    """After flying into rising air with a sharp edge."""


class _UnsteadyWing:
    """A lattice with further points (n, 3) where what it induces is wanted, ready to march `travelled` m."""

    def __init__(self, lattice: Lattice, points: Array, travelled: float) -> None:
        self.lattice = lattice
        self.rows = int(np.ceil(travelled / lattice.step))
        x, y = lattice.controls()
        self._panels = x.size
        control = np.column_stack([x.ravel(), np.broadcast_to(y, x.shape).ravel(), np.zeros(x.size)])
        seen = np.vstack([control, points])
        rings = lattice.rings()
        bound = _of_rings(seen, rings, lattice.y).reshape(len(seen), -1)
        wake = _of_rings(seen, rings[-1] + lattice.step * np.arange(self.rows + 1)[:, None], lattice.y)
        self._wake = wake.reshape(len(seen), -1)
        self._of_points = bound[x.size :].copy()
        self._solve = np.linalg.inv(bound[: x.size])
        far = _of_rings(seen, np.vstack([rings[-1], rings[-1] + _FAR * lattice.y[-1]]), lattice.y)[:, 0]
        bound[:, -lattice.shape[1] :] += far
        steady = np.linalg.solve(bound[: x.size], -np.ones(x.size))
        self._circulation = float(steady.reshape(lattice.shape)[-1] @ np.diff(lattice.y))
        self.lift_slope = 4 * self._circulation / lattice.area
        self.upwash = np.asarray(bound[x.size :] @ steady)

    def motion(self) -> StepResponse:
        return self._march(np.ones((self.rows, self._panels)), 0.0)

    def gust(self) -> StepResponse:
        """Of each panel what is in the rising air has its upwash."""
        lattice = self.lattice
        edge = min(0.0, float(lattice.x.min()))
        way = edge + lattice.step * np.arange(1, self.rows + 1)
        front = ((lattice.x[:, 1:] + lattice.x[:, :-1]) / 2)[:-1]
        inside = np.clip((way[:, None, None] - front) / lattice.depth, 0.0, 1.0)
        return self._march(inside.reshape(self.rows, -1), edge + lattice.step)

    def _march(self, wash: Array, first: float) -> StepResponse:
        """Through so many steps of the air's upwash at the controls, (steps, panels), the first at the way `first`."""
        lattice = self.lattice
        columns, width = lattice.shape[1], np.diff(lattice.y)
        shed = np.zeros((self.rows, columns))
        before = np.zeros(lattice.shape)
        lift = np.zeros(self.rows)
        upwash = np.zeros((len(self._of_points), self.rows))
        for n in range(self.rows):
            late = self._wake[:, : n * columns] @ shed[:n][::-1].ravel()
            rings = (self._solve @ (-wash[n] - late[: self._panels])).reshape(lattice.shape)
            growing = np.sum((rings - before) * lattice.depth * width) / lattice.step
            lift[n] = (rings[-1] + before[-1]) @ width / 2 + growing
            upwash[:, n] = self._of_points @ rings.ravel() + late[self._panels :]
            shed[n], before = rings[-1], rings
        steady = np.where(self.upwash == 0, 1.0, self.upwash)
        way = np.asarray(first + lattice.step * np.arange(self.rows), dtype=np.float64)
        return StepResponse(way, lift / self._circulation, upwash / steady[:, None])


def wing_response(lattices: tuple[Lattice, Lattice], points: Array, travelled: float) -> WingResponse:
    """Of two lattices of one wing, the second with panels half as deep, to panels without depth: the error is of first
    order in it (Richardson). `points` (n, 3) are where upwash is wanted, `travelled` how far steps are followed, m."""
    coarse, fine = (_UnsteadyWing(lattice, points, travelled) for lattice in lattices)

    def to_none(a: StepResponse, b: StepResponse) -> StepResponse:
        way = a.way[2:]
        lift = 2 * np.interp(way, b.way, b.lift) - a.lift[2:]
        upwash = [2 * np.interp(way, b.way, u) - v[2:] for u, v in zip(b.upwash, a.upwash, strict=True)]
        return StepResponse(way, lift, np.asarray(upwash).reshape(len(points), len(way)))

    return WingResponse(
        2 * fine.lift_slope - coarse.lift_slope,
        2 * fine.upwash - coarse.upwash,
        to_none(coarse.motion(), fine.motion()),
        to_none(coarse.gust(), fine.gust()),
    )
