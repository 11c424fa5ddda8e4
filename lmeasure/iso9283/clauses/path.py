"""Path accuracy and repeatability (clauses 8.2 to 8.4): the crossings of a path, and the errors that they have."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, IntArray, se3
from lmeasure.iso9283 import formulas as iso
from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity, SampleErrors
from lmeasure.iso9283.figure import ANGLES, Figure, Maker, Subject, angle_rates, angles_deg, cosines, reduced
from lmeasure.iso9283.formulas import wrapped
from lmeasure.iso9283.paths import Crossings
from lmeasure.iso9283.sample_gaps import of_samples, with_hidden
from lmeasure.iso9283.uncertainty import NORMAL_95_ONE_SIDED, Part, of_crossing
from lmeasure.trajectory import PoseErrors, Stamps, of_crossings

CENTRAL = 0.5
"""Middle part of a line between corners in which velocities are taken (8.6.1): there the robot neither starts nor turns."""

DOUBT_OF_MEAN, DOUBT_OF_SCATTER = 1.0, NORMAL_95_ONE_SIDED
"""See `waves.reduced`. Repeatabilities are the largest of many figures of few cycles each, which errors enlarge more than all else."""


@dataclass(frozen=True, kw_only=True)
class PathTest(IsoTest):
    """AT, and RT from two cycles on, of one path; convention of component-wise angles, None where there are none; clause: of its
    accuracy, 8.4 where the tool turns on the way. plain: not of a weave, which leaves its path on purpose."""

    crossings: Crossings
    convention: str | None
    stamps: Stamps
    clause: str
    plain: bool

    def samples(self) -> IntArray:
        return self.crossings.samples.ravel()

    def excludable(self, errors: SampleErrors) -> PoseErrors:
        """Return errors of the positions at any instants; see `IsoTest`."""
        c = self.crossings
        single = errors(c.samples.ravel())
        return of_crossings(single, c.weights, c.step, c.scatter) if single.rounded else single

    def parts(self, errors: SampleErrors) -> dict[Subject, Part]:
        c, places = self.crossings, self.excludable(errors)
        if c.hidden is None:
            return {self.subject: PathPart(c, places, self.convention, self.stamps)}
        bound, _ = c.hidden.bound(of_samples(errors(self.samples())), self.stamps.u_time_s)
        return {self.subject: PathPart(c, places, self.convention, self.stamps, bound)}

    def figures(self) -> list[Figure]:
        if not self.plain:
            return []
        key, c = self.subject, self.crossings
        n, turns = c.time_s.shape[1], c.line.path.quaternion_xyzw is not None and not np.isnan(c.attained[0, 0, 3])
        make = Maker(cycles=n, needs=(key,), path=key.name, angles=self.convention)
        out = [make.one("AT_p", self.clause, "mm", lambda s: iso.path_accuracy(s[key].position), extreme=True)]
        if self.convention is not None:
            out += make.components("AT", self.clause, lambda s: iso.path_orientation_accuracy(s[key].angles_deg), ANGLES)
        if turns:
            out.append(make.rotation("AT_rot", self.clause, lambda s: iso.path_accuracy(s[key].turn_deg)))
        if n < 2:
            return out
        out.append(make.one("RT_p", "8.3", "mm", lambda s: iso.path_repeatability(s[key].position)))
        if self.convention is not None:
            out += make.components("RT", "8.3", lambda s: iso.path_orientation_repeatability(s[key].angles_deg), ANGLES)
        if turns:
            out.append(make.rotation("RT_rot", "8.3", lambda s: iso.path_repeatability(s[key].turn_deg)))
        return out


def tests(attained: Attainment) -> Iterator[PathTest]:
    """Return the tests of every path that has windows."""
    for path in attained.program.path:
        if path.name in attained.paths:
            crossed = attained.paths[path.name]
            convention, findings = attained.convention_on_path(crossed)
            yield PathTest(
                subject=Subject("path", path.name),
                windows=path.windows_s,
                angle_deg=crossed.angle_deg,
                findings=findings,
                crossings=crossed,
                convention=convention,
                stamps=attained.stamps,
                clause="8.4" if path.end_quaternion_xyzw is not None else "8.2",
                plain=path.weave_stroke_mm is None,
            )


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
    """The crossings of a path with the law of the errors of its m n places, plane by plane, and of their instants; see
    `uncertainty.Part`. hidden (m n, 3) [mm]: how far the path may lie off between the samples there."""

    crossings: Crossings
    places: PoseErrors
    convention: str | None
    stamps: Stamps
    hidden: FloatArray | None = None
    _states: dict[bool, Planes] = field(init=False, default_factory=dict)
    _rates: list[FloatArray] = field(init=False, default_factory=list)

    @property
    def positions(self) -> FloatArray:
        return self.crossings.attained[:, :, :3].reshape(-1, 3)

    @cached_property
    def errors(self) -> PoseErrors:
        timed = of_crossing(self.places, self.crossings, self.stamps)
        return timed if self.hidden is None else with_hidden(timed, self.hidden, self.hidden)

    def __post_init__(self) -> None:
        c = self.crossings
        m, stretch = len(c.way_mm), c.stretch
        planes, unit = np.eye(m), np.tile(np.degrees(np.eye(3)), (m, 1, 1))
        none = np.zeros_like(unit)
        across = self._across()
        position = np.einsum("mij,mnj->mni", across, c.attained[:, :, :3] - c.commanded[:, None])
        less = self._likely(position, stretch, planes, np.concatenate([none, across], axis=2))
        less = np.einsum("mij,mnj->mni", across, less)
        turn, angles = self._orientation()
        less_turn = less_angles = None
        if turn is not None:
            less_turn = self._likely(turn, stretch, planes, np.concatenate([unit, none], axis=2))
        if angles is not None:
            less_angles = self._likely(angles, stretch, planes, np.concatenate([self._rates[0], none], axis=2))
        middle = self._middle
        speed = c.speed_mm_s[:, middle]
        rows = (np.diff(planes / c.pace_mm_s.mean(axis=1)[:, None], axis=0) / self._lasted.mean(axis=0)[:, None])[middle]
        rows *= speed.mean(axis=0)[:, None]
        along = np.concatenate([none[:, :1], c.tangent[:, None, :]], axis=2)
        # differences of speed, also between lines, are fluctuation; their common part is not
        fluctuation = (speed - speed.mean()).T[:, :, None]
        less_speed = speed.mean() + self._likely(fluctuation, stretch[middle], rows, along)[:, :, 0].T
        self._states[False] = Planes(position, angles, turn, speed)
        self._states[True] = Planes(less, less_angles, less_turn, less_speed)

    def _likely(self, values: FloatArray, stretch: IntArray, rows: FloatArray, to: FloatArray) -> FloatArray:
        """Return values as likely as the measured ones (q, n, c), at places in stretches (q,). Their errors are rows (q, m) of `to` (m, c,
        6) times the errors at the planes. Errors of means over cycles and of differences between cycles have different powers."""
        m, n = self.crossings.time_s.shape
        random = self.errors.random.reshape(m, n, 6, 6).mean(axis=1)
        factors = self.errors.factors.reshape(m, n, 6, -1).mean(axis=1)
        along = cosines(stretch)
        added = (along @ rows) ** 2 @ np.einsum("mci,mij,mcj->mc", to, random, to)
        common = np.einsum("qm,mcl->qcl", along @ rows, to @ factors)
        waves = np.einsum("pq,qnc->pnc", along, values)
        mean = waves.mean(axis=1, keepdims=True)
        likely = reduced(mean, added / n + (common**2).sum(axis=2), 1, DOUBT_OF_MEAN)
        if self.errors.joint and n > 1:
            # each cycle of a curve has an error of its own
            of_cycles = self.errors.factors.reshape(m, n, 6, -1)
            apart = np.einsum(
                "qm,mnl->qnl",
                along @ rows,
                np.einsum("mci,mnil->mncl", to, of_cycles - of_cycles.mean(axis=1, keepdims=True)).reshape(m, n, -1),
            )
            added = added + (apart.reshape(len(apart), n, to.shape[1], -1) ** 2).sum(axis=(1, 3)) / (n - 1)
        likely = likely + reduced(waves - mean, added, max(n - 1, 1), DOUBT_OF_SCATTER)
        return np.einsum("pq,pnc->qnc", along, likely)

    def _across(self) -> FloatArray:
        """(m, 3, 3) projectors onto the planes: along the path a crossing has no deviation."""
        t = self.crossings.tangent
        return np.asarray(np.eye(3) - t[:, :, None] * t[:, None, :])

    @property
    def _lasted(self) -> FloatArray:
        """(n, m - 1) how long [s] the way from plane to plane took."""
        return np.asarray(np.diff(self.crossings.time_s, axis=0).T)

    @property
    def _middle(self) -> IntArray:
        """(k,) numbers of the pieces between planes in the middle of the straight lines of the path, or of all of it where it has none."""
        stretch = self.crossings.stretch
        pieces = [np.flatnonzero((stretch[:-1] == s) & (stretch[1:] == s)) for s in np.unique(stretch)]
        edges = [round(len(p) * (1.0 - CENTRAL) / 2.0) for p in pieces]
        middle = np.concatenate([p[edge : len(p) - edge] for p, edge in zip(pieces, edges, strict=True)])
        return middle if len(middle) else np.arange(len(stretch) - 1)

    def _orientation(self) -> tuple[FloatArray | None, FloatArray | None]:
        c = self.crossings
        commanded = c.line.orientation(c.way_mm)
        if commanded is None or np.isnan(c.attained[0, 0, 3]):
            return None, None
        m, n = c.time_s.shape
        attained = se3.rotation(c.attained.reshape(-1, 7))
        there = Rotation.from_quat(np.repeat(commanded.as_quat(), n, axis=0))
        turn = np.degrees((attained * there.inv()).as_rotvec()).reshape(m, n, 3)
        if self.convention is None:
            return turn, None
        self._rates.append(angle_rates(self.convention, commanded))
        return turn, wrapped(angles_deg(self.convention, attained) - angles_deg(self.convention, there)).reshape(m, n, 3)

    def state(self, errors: FloatArray, reduced: bool) -> Planes:
        c, state = self.crossings, self._states[reduced]
        m, n = c.time_s.shape
        e = errors.reshape(*errors.shape[:-2], m, n, 6)
        along = np.einsum("...mni,mi->...nm", e[..., 3:], c.tangent)
        position = state.position + e[..., 3:] - np.swapaxes(along, -1, -2)[..., None] * c.tangent[:, None, :]
        # a measured position ahead of the true one crosses a plane earlier, by the robot's travel time
        stretch = (np.diff(along / c.pace_mm_s.T, axis=-1) / self._lasted)[..., self._middle]
        turned = e[..., :3]
        return Planes(
            position,
            None if state.angles_deg is None else state.angles_deg + turned @ np.swapaxes(self._rates[0], -1, -2),
            None if state.turn_deg is None else state.turn_deg + np.degrees(turned),
            state.speed_mm_s * (1.0 + stretch),
        )


CLAUSE = Clause(
    tests=tests,
    quantities=(
        Quantity(symbol="AT", label="path accuracy", summary={"AT_p": 70, "AT_rot": 260}, trend="AT_p"),
        Quantity(symbol="RT", label="path repeatability", summary={"RT_p": 80, "RT_rot": 270}, trend="RT_p"),
    ),
)
