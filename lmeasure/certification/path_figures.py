"""Figures of clauses 8 and 11: what is certified of paths and of corners."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure.certification import iso9283_path as iso
from lmeasure.certification.errors_of_poses import PoseErrors
from lmeasure.certification.figures import ANGLES, Figure, angle_rates, angles_deg, components
from lmeasure.certification.iso9283_pose import wrapped
from lmeasure.certification.paths import Crossings, Cycle
from lmeasure.certification.uncertainty import reduction, reduction_of_mean
from lmeasure.errors import CertificationError
from lmeasure.program import CommandedPath

FloatArray = NDArray[np.float64]

SHARP_DEG = 20.0
"""A path of points turns a corner where its direction changes by more."""
NEIGHBOURS = 2
"""Planes on either side over which the likely deviations are averaged."""
CENTRAL = 0.5
"""Of the path's length: velocities are taken in its middle (8.6.1)."""


@dataclass(frozen=True)
class Planes:
    """Deviations from the commanded path at m planes, n cycles: position (..., m, n, 3) [mm], angles and rotation vectors (..., m, n, 3)
    [deg] or None; speed (..., n, k) [mm/s] in the middle of the path."""

    position: FloatArray
    angles_deg: FloatArray | None
    turn_deg: FloatArray | None
    speed_mm_s: FloatArray


@dataclass(frozen=True)
class PathPart:
    """The crossings of a path with the law of the errors of its m n poses, plane by plane; see `uncertainty.Part`."""

    crossings: Crossings
    errors: PoseErrors
    convention: str | None
    _states: dict[bool, Planes] = field(init=False, default_factory=dict)
    _rates: list[FloatArray] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        c, e = self.crossings, self.errors
        m, n = c.time_s.shape
        across = self._across()
        random = e.random.reshape(m, n, 6, 6).mean(axis=1)
        factors = np.concatenate([e.own, e.shared], axis=2).reshape(m, n, 6, -1).mean(axis=1)
        of_mean = random / n + factors @ factors.transpose(0, 2, 1)
        position = np.einsum("mij,mnj->mni", across, c.attained[:, :, :3] - c.commanded[:, None])
        noise = across @ random[:, 3:, 3:] @ across
        mean_noise = across @ of_mean[:, 3:, 3:] @ across
        less = _reduced(position, np.trace(noise, axis1=1, axis2=2), np.trace(mean_noise, axis1=1, axis2=2))
        turn, angles = self._orientation()
        less_turn = less_angles = None
        if turn is not None:
            unit = np.degrees(1.0) ** 2
            of = (unit * np.trace(x[:, :3, :3], axis1=1, axis2=2) for x in (random, of_mean))
            less_turn = _reduced(turn, *of)
        if angles is not None:
            unit = 1.0
            blocks = [self._rates[0] @ x[:, :3, :3] @ self._rates[0].transpose(0, 2, 1) for x in (random, of_mean)]
            less_angles = _reduced(angles, *(np.trace(b, axis1=1, axis2=2) for b in blocks))
        speed = c.speed_mm_s[:, self._middle]
        along = np.einsum("mi,mij,mj->m", c.tangent, random[:, 3:, 3:], c.tangent)
        added = 2.0 * along.mean() / np.mean(np.diff(c.way_mm)) ** 2 * np.mean(speed) ** 2
        mean_speed = speed.mean(axis=1, keepdims=True)
        less_speed = mean_speed + reduction(((speed - mean_speed) ** 2).mean(), added) * (speed - mean_speed)
        self._states[False] = Planes(position, angles, turn, speed)
        self._states[True] = Planes(less, less_angles, less_turn, less_speed)

    def _across(self) -> FloatArray:
        """(m, 3, 3) projectors onto the planes: along the path a crossing has no deviation."""
        t = self.crossings.tangent
        return np.asarray(np.eye(3) - t[:, :, None] * t[:, None, :])

    @property
    def _middle(self) -> slice:
        """Of the pieces between planes, those in the middle of the path."""
        pieces = len(self.crossings.way_mm) - 1
        edge = round(pieces * (1.0 - CENTRAL) / 2.0)
        return slice(edge, pieces - edge)

    def _orientation(self) -> tuple[FloatArray | None, FloatArray | None]:
        c = self.crossings
        commanded = c.line.orientation(c.way_mm)
        if commanded is None or np.isnan(c.attained[0, 0, 3]):
            return None, None
        m, n = c.time_s.shape
        attained = Rotation.from_quat(c.attained[:, :, 3:].reshape(-1, 4))
        there = Rotation.from_quat(np.repeat(commanded.as_quat(), n, axis=0))
        turn = np.degrees((attained * there.inv()).as_rotvec()).reshape(m, n, 3)
        if self.convention is None:
            return turn, None
        self._rates.append(angle_rates(self.convention, commanded))
        return turn, wrapped(angles_deg(self.convention, attained) - angles_deg(self.convention, there)).reshape(m, n, 3)

    def state(self, errors: FloatArray, reduced: bool) -> Planes:
        """See `uncertainty.Part`."""
        c, state = self.crossings, self._states[reduced]
        m, n = c.time_s.shape
        e = errors.reshape(*errors.shape[:-2], m, n, 6)
        along = np.einsum("...mni,mi->...nm", e[..., 3:], c.tangent)
        position = state.position + e[..., 3:] - np.swapaxes(along, -1, -2)[..., None] * c.tangent[:, None, :]
        stretch = (np.diff(along, axis=-1) / np.diff(c.way_mm))[..., self._middle]
        turned = e[..., :3]
        return Planes(
            position,
            None if state.angles_deg is None else state.angles_deg + np.einsum("mij,...mnj->...mni", self._rates[0], turned),
            None if state.turn_deg is None else state.turn_deg + np.degrees(turned),
            state.speed_mm_s * (1.0 + stretch),
        )


def _reduced(values: FloatArray, added: FloatArray, added_to_mean: FloatArray) -> FloatArray:
    """Deviations (m, n, 3) with their scatter and their means reduced by what errors have added (m,).

    First they are averaged over neighbouring planes, which takes what rounding has added to each of them and leaves what the robot does
    over several: of scaled deviations the largest would still be those that rounding made the largest.
    """
    m, n, _ = values.shape
    at = np.clip(np.arange(m)[:, None] + np.arange(-NEIGHBOURS, NEIGHBOURS + 1), 0, m - 1)
    values, left = values[at].mean(axis=1), 1.0 / at.shape[1]
    mean = values.mean(axis=1, keepdims=True)
    away = values - mean
    freedom = max(n - 1, 1)
    scatter = reduction((away**2).sum() / freedom, left * added.sum(), freedom)
    return np.asarray(reduction_of_mean((mean[:, 0] ** 2).sum(axis=1), added_to_mean)[:, None, None] * mean + scatter * away)


def path_figures(key: str, part: PathPart, path: CommandedPath) -> list[Figure]:
    """AT, RT (8.2, 8.3; 8.4 where the tool turns on the way), AV, RV, FV (8.6) where a speed is commanded."""
    n = part.crossings.time_s.shape[1]
    clause = "8.4" if path.end_quaternion_xyzw is not None else "8.2"
    common: dict[str, Any] = {"cycles": n, "needs": (key,), "path": path.name}
    state = part.state(np.zeros((part.crossings.time_s.size, 6)), reduced=False)
    angular: dict[str, Any] = {"unit": "deg", "angles": part.convention, **common}
    rot: dict[str, Any] = {"unit": "deg", "extension": True, **common}
    out = []
    if path.weave_stroke_mm is None:
        out.append(Figure("AT_p", clause, "mm", of=lambda s: iso.path_accuracy(s[key].position), **common))
        if state.angles_deg is not None:
            names = [f"AT_{a}" for a in ANGLES]
            out += components(names, lambda s: iso.path_orientation_accuracy(s[key].angles_deg), clause=clause, **angular)
        if state.turn_deg is not None:
            out.append(Figure("AT_rot", clause, of=lambda s: iso.path_accuracy(s[key].turn_deg), **rot))
    if n > 1 and path.weave_stroke_mm is None:
        out.append(Figure("RT_p", "8.3", "mm", of=lambda s: iso.path_repeatability(s[key].position), **common))
        if state.angles_deg is not None:
            names = [f"RT_{a}" for a in ANGLES]
            out += components(names, lambda s: iso.path_orientation_repeatability(s[key].angles_deg), clause="8.3", **angular)
        if state.turn_deg is not None:
            out.append(Figure("RT_rot", "8.3", of=lambda s: iso.path_repeatability(s[key].turn_deg), **rot))
    speed = path.speed_mm_s
    if speed is not None:
        out.append(Figure("AV", "8.6.2", "%", of=lambda s: iso.velocity_accuracy(s[key].speed_mm_s, speed), **common))
        if n > 1:
            out.append(Figure("RV", "8.6.3", "%", of=lambda s: iso.velocity_repeatability(s[key].speed_mm_s, speed), **common))
    out.append(Figure("FV", "8.6.4", "mm/s", of=lambda s: iso.velocity_fluctuation(s[key].speed_mm_s), **common))
    return out


@dataclass(frozen=True)
class Corner:
    """A corner of a path: number, its place (3,) [mm], unit directions (3,) into it and out of it, and how far each line goes [mm]."""

    number: int
    place: FloatArray
    incoming: FloatArray
    outgoing: FloatArray
    way_mm: float
    before_mm: float
    after_mm: float


def corners_of(crossings: Crossings) -> list[Corner]:
    """The corners between the straight lines of a path; a closed path's start is none."""
    if crossings.line.path.kind == "circular":
        return []
    points, arc = crossings.line.corners, crossings.line.arc
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    units = steps / lengths[:, None]
    turned = np.degrees(np.arccos(np.clip((units[1:] * units[:-1]).sum(axis=1), -1.0, 1.0)))
    return [
        Corner(i + 1, points[i + 1], units[i], units[i + 1], float(arc[i + 1]), float(lengths[i]), float(lengths[i + 1]))
        for i in np.flatnonzero((turned > SHARP_DEG) & (turned < 180.0 - 1e-6)).tolist()
    ]


@dataclass(frozen=True)
class CornerPart:
    """What each cycle does at a corner, as vectors [mm] with the law of their errors (n poses): nearest (n, 3) from the corner to the
    nearest point of the path, beyond (n, k, 3) from the second line to points about the farthest in the direction of the first."""

    nearest: FloatArray
    beyond: FloatArray
    of_cycles: PoseErrors

    @property
    def errors(self) -> PoseErrors:
        """Of the n nearest points and the n k others: the largest of many readings is larger than what they are of."""
        n, k, _ = self.beyond.shape
        return self.of_cycles[np.concatenate([np.arange(n), np.repeat(np.arange(n), k)])]

    def state(self, errors: FloatArray, reduced: bool) -> tuple[FloatArray, FloatArray]:
        """See `uncertainty.Part`; likely are the parabolas through the points about the farthest."""
        n, k, _ = self.beyond.shape
        beyond = self.beyond
        if reduced:
            powers = np.linspace(-1.0, 1.0, k)[:, None] ** np.arange(3)
            beyond = powers @ np.linalg.pinv(powers) @ beyond
        moved = errors[..., 3:]
        return self.nearest + moved[..., :n, :], beyond + moved[..., n:, :].reshape(*moved.shape[:-2], n, k, 3)


ABOUT = 7  # samples on either side of the farthest


def at_corner(cycle: Cycle, corner: Corner, what: str) -> tuple[FloatArray, FloatArray, int, FloatArray, FloatArray]:
    """Of one cycle: `nearest` (3,) and `beyond` (k, 3) of `CornerPart`, the sample nearest to the corner, and behind the corner the way
    (j,) along the second line and the deviation (j,) from it [mm]; what: the cycle, for CertificationError when it does not pass the
    corner."""
    near = np.flatnonzero((cycle.way_mm > corner.way_mm - 0.5 * corner.before_mm) & (cycle.way_mm < corner.way_mm + 0.5 * corner.after_mm))
    if len(near) < 2:
        raise CertificationError(f"{what}: has {len(near)} samples within half a side of corner {corner.number}; at least 2")
    positions = cycle.poses[near[0] : near[-1] + 1, :3] - corner.place
    steps = np.diff(positions, axis=0)
    square = np.maximum((steps**2).sum(axis=1), 1e-300)
    part = np.clip(-(positions[:-1] * steps).sum(axis=1) / square, 0.0, 1.0)
    feet = positions[:-1] + part[:, None] * steps
    i = int(np.argmin((feet**2).sum(axis=1)))
    after = positions[i:]
    along = after @ corner.outgoing
    away = after - along[:, None] * corner.outgoing
    side = corner.incoming - (corner.incoming @ corner.outgoing) * corner.outgoing
    k = int(np.argmax(away @ side))
    about = np.clip(np.arange(k - ABOUT, k + ABOUT + 1), 0, len(away) - 1)
    return feet[i], away[about], int(cycle.samples[near[0] + i]), along, np.linalg.norm(away, axis=1)


def corner_figures(key: str, corner: Corner, path: CommandedPath, cycles: int) -> list[Figure]:
    """Clause 8.5: CR and CO of one corner."""
    side = corner.incoming - (corner.incoming @ corner.outgoing) * corner.outgoing
    side /= np.linalg.norm(side)
    common: dict[str, Any] = {
        "cycles": cycles,
        "needs": (f"path {path.name}",),
        "path": path.name,
        "part": f"corner {corner.number}",
        "clause": "8.5",
    }

    def overshoot(s: Mapping[str, Any]) -> FloatArray:
        return iso.cornering_overshoot(s[key][1], side)

    return [
        Figure("CR", unit="mm", of=lambda s: iso.cornering_round_off(s[key][0]), **common),
        Figure("CO", unit="mm", of=overshoot, **common),
    ]
