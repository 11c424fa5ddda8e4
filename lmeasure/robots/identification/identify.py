"""Identification: the errors of a robot's model, from joint values and measurements at them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Generic, Literal

import numpy as np
import scipy

from lmeasure.accuracy import radii_95
from lmeasure.core import BoolArray, DataFrame, FloatArray, IntArray, RobotError, Shown, framed, se3, words_of
from lmeasure.robots.identification.measurements import (
    LENGTH,
    NOWHERE,
    POSITION,
    Beyond,
    Measurements,
    Noted,
    Stays,
    agreeing,
    measured,
    named_alike,
    noted,
    read_at_stays,
    repeated,
    stays_of,
)
from lmeasure.robots.identification.problem import LEAST_MM, LEAST_RAD, Fit, Linear, Noise, Problem, distances, solved, weighted, with_noise
from lmeasure.robots.identification.unknowns import Frames, R, State, Unknowns, find_frames
from lmeasure.robots.model import joint_value
from lmeasure.robots.parallel.model import Parallel, legs_at
from lmeasure.text import message

OUTLYING = 1e-6
"""Probability, over all rows, with which a row of Gaussian errors would be taken for an outlier."""
OUTLIER_ROUNDS = 12
LEAST_SPARE = 2.0
"""Residuals beyond the determined unknowns that are needed to estimate the noise of robot and instrument."""
HALF = 0.5
"""Weight of a row below which it is named, and part of all rows that their weights must leave."""


def of_all(fit: Fit[R], rows: Measurements, used: BoolArray) -> tuple[FloatArray, IntArray]:
    """Return `distances` of all rows, with used (N,) rows of the fit, and the number of components of each (N,); for a stay with several
    rows, the other used rows of the stay count too."""
    problem = replace(fit.problem, rows=rows, weight=None)
    at, square = problem.linearised(fit.theta), np.zeros(len(rows))
    for of in problem.stays:
        if of.shape[1] == 1:
            square[of[:, 0]] = distances(fit, problem, at, of, counts=used[of[:, 0]].astype(np.float64))
        else:
            for one in of:
                square[one] = _within(fit, problem, at, one, used[one])
    return square, np.asarray(rows.known.sum(axis=1))


def _within(fit: Fit[R], problem: Problem[R], at: Linear, of: IntArray, used: BoolArray) -> FloatArray:
    """Return (m,) squared distances of the rows (m,) of one stay from the prediction by all others, the stay's own used rows (m,) among
    them."""
    n = at.residuals.shape[1]
    r, J, V = at.residuals[of].reshape(-1), at.jacobian[of].reshape(len(of) * n, -1), problem.of_stays(of[None])[0]
    known, owner = problem.rows.known[of].reshape(-1), np.repeat(np.arange(len(of)), n)
    on = known & used[owner]
    out = np.zeros(len(of))
    inverse = np.linalg.inv(V[np.ix_(on, on)])
    left = inverse - inverse @ J[on] @ fit.covariance @ J[on].T @ inverse
    seen = inverse @ r[on]
    for i in range(len(of)):
        own = known & (owner == i)
        if used[i]:
            part = owner[on] == i
            out[i] = float(seen[part] @ np.linalg.pinv(left[np.ix_(part, part)], hermitian=True) @ seen[part])
            continue
        gain = V[np.ix_(own, on)] @ inverse
        by = J[own] - gain @ J[on]
        spread = V[np.ix_(own, own)] - gain @ V[np.ix_(on, own)] + by @ fit.covariance @ by.T
        off = r[own] - gain @ r[on]
        out[i] = float(off @ np.linalg.solve(spread, off))
    return out


def _contradicted_stays(fit: Fit[R], rows: Measurements, used: BoolArray, fits: BoolArray, *, scale: float) -> BoolArray:
    """(N,) rows whose stay the others contradict, where several of its rows that fit each other are used, or would be."""
    problem = replace(fit.problem, rows=rows, weight=None)
    at, out = problem.linearised(fit.theta), np.zeros(len(rows), np.bool_)
    for of in problem.stays[1:] if problem.stays[0].shape[1] == 1 else problem.stays:
        for one in of:
            part = one[fits[one]]
            if len(part) < 2:
                continue
            square = distances(fit, problem, at, part[None], counts=np.array([float(used[part].all())]))[0]
            out[part] = square > scipy.stats.chi2.isf(OUTLYING / len(rows), int(rows.known[part].sum())) * scale
    return out


def without_outliers(fit: Fit[R], rows: Measurements, used: BoolArray) -> tuple[Fit[R], BoolArray]:
    """The fit with rows set aside that the others contradict, and which are used: begun with those nearest, then let in as they fit.

    Distances are judged by their median, which half of the rows may spoil.
    """
    for _ in range(OUTLIER_ROUNDS):
        square, components = of_all(fit, rows, used)
        normal = scipy.stats.chi2.ppf(0.5, np.arange(1, 7))[np.maximum(components, 1) - 1]
        scale = max(1.0, float(np.median((square / normal)[components > 0]))) if fit.equations > 1.5 * len(fit.theta) else 1.0
        limit = scipy.stats.chi2.isf(OUTLYING / len(rows), np.maximum(components, 1)) * scale
        now = (square <= limit) | (components == 0)
        now &= ~_contradicted_stays(fit, rows, used, now, scale=scale)
        if (now == used).all():
            break
        used = now
        fit = with_noise(replace(fit.problem, rows=rows.of(np.flatnonzero(used))), fit.theta)
    return fit, used


def weighed(fit: Fit[R], rows: Measurements, used: BoolArray) -> tuple[Fit[R], BoolArray]:
    """The fit with all rows weighed, begun with those used, and which keep a weight. RobotError where there is not enough to weigh, or the
    weights leave too little."""
    if fit.spare < LEAST_SPARE:
        raise RobotError(message("error.measured_values_are_used", equations=fit.equations))
    fit = weighted(solved(replace(fit.problem, rows=rows, weight=used.astype(np.float64)), fit.theta))
    weight = fit.problem.weight
    assert weight is not None
    if fit.spare < LEAST_SPARE or weight.sum() < HALF * len(rows):
        raise RobotError(message("error.weights_leave_of_rows", weight=weight.sum(), n_rows=len(rows)))
    used = weight > 0.0
    return solved(replace(fit.problem, rows=rows.of(np.flatnonzero(used)), weight=weight[used]), fit.theta), used


def outlying(fit: Fit[R], rows: Measurements, kept: BoolArray, used: BoolArray) -> list[Noted]:
    """Return the report of each row that is kept and not used: out of reach, or its difference from the prediction [mm, deg]."""
    out = []
    state = fit.problem.unknowns.state(fit.x)
    predicted = state.predicted(rows)
    reach = state.robot.reach_mm + np.linalg.norm(state.targets[:, :3], axis=1)
    away = np.linalg.norm(rows.position - state.base[:3], axis=1)
    for row in np.flatnonzero(kept & ~used).tolist():
        of, row_said = rows.names[row], rows.subject(row)
        if rows.placed[row] and away[row] > reach[rows.target_of[row]]:
            off = float(away[row])
            reaches = float(reach[rows.target_of[row]])
            out.append(noted("row-out-of-reach", "out_of_reach", of, off, row=row_said, away_mm=off, reach_mm=reaches))
        elif not rows.placed[row]:
            off = float(np.abs(fit.problem.unknowns.residuals(fit.x, rows)[row]).max())
            out.append(noted("outlier", "outlier.length", of, off, row=row_said, off_mm=off))
        else:
            off = float(np.linalg.norm(rows.position[row] - predicted[row, :3]))
            if not rows.oriented[row]:
                out.append(noted("outlier", "outlier", of, off, row=row_said, off_mm=off))
                continue
            turned = se3.between(predicted[row], np.concatenate([rows.position[row], rows.quaternion[row]]))
            angle = float(np.degrees(se3.rotation(turned).magnitude()))
            out.append(noted("outlier", "outlier.turned", of, off, row=row_said, off_mm=off, turned_deg=angle))
    return out


FOREIGN = 0.01
"""Part of the positions' spread from which the remaining errors show another robot."""
MISFIT = 1e-3
"""Probability of the residuals under the stated uncertainties, below which these are reported as too small."""
LEAST_POSES = 8
"""Measured with their orientation, from which on a mechanism's legs are fitted one by one to begin with."""
UNMOVED_DEG, UNMOVED_MM = 0.1, 0.1
"""Range of a joint's values up to which it never moved."""
ENOUGH = 30
"""Rows from which on it is given in which directions errors lie."""
LINKS = ("theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg")
ONCE, TWICE = ("sin1_deg", "cos1_deg", "sin1_mm", "cos1_mm"), ("sin2_deg", "cos2_deg", "sin2_mm", "cos2_mm")
FAMILIES: dict[str, tuple[str, ...]] = {
    "links": LINKS,
    "once": ONCE,
    "twice": TWICE,
    "scale": ("scale",),
    "stiffness": ("compliance_deg_per_nm", "compliance_mm_per_n"),
    "backlash": ("backlash_deg", "backlash_mm"),
}
"""Families that may be freed, by the ends of the parameters' names; a parameter of none of them is freed with the links."""


@dataclass(frozen=True)
class Settings:
    """free: families of parameters, see `FAMILIES`; outliers: whether rows that the others contradict are rejected; weights: whether the
    others count alike, or each by Tukey's biweight of its distance from all others; seed: of starts."""

    free: tuple[str, ...] = ("links",)
    outliers: bool = True
    seed: int = 0
    weights: Literal["cut", "biweight"] = "cut"
    own_noise: bool = True
    """Whether the robot has errors beyond the stated ones of the measurements; not if poses of both are stated."""
    u_links_mm: float | None = None
    """Standard uncertainty of the nominal lengths of links or legs; None: as parameters have it."""
    u_links_deg: float | None = None
    """The same of angles."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "free", words_of(self.free))


@dataclass(frozen=True, repr=False)
class Identified(Shown, Generic[R]):
    """Result of an identification. rows: as measured, with `kept` of them not set aside; findings: in the order in which they were made."""

    nominal: R
    fit: Fit[R]
    rows: Measurements
    mean_of: IntArray
    """(N,) which row of the fit's, the mean of readings of a stay, each row is part of; -1 where it was set aside."""
    findings: tuple[Noted, ...]
    nominal_state: State[R]
    """The frames that fit best with the nominal robot."""
    settings: Settings
    misfit: float = 1.0
    """Factor from stated to actual errors of validation rows, if above 1 (`hold_out.CrossValidation.misfit`)."""
    beyond: Beyond = NOWHERE
    """Widening of predictions far from the measured joint values (`hold_out.beyond`)."""
    state: State[R] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "state", self.fit.problem.unknowns.state(self.fit.x))

    def about(self) -> dict[str, str]:
        """Return the number of rows, and how far they are off before and after."""
        used = self.kept & self.rows.placed
        before, after = (float(np.linalg.norm(e[used], axis=1).mean()) for e in (self.nominal_errors_mm(), self.errors_mm()))
        scatter = f"{self.noise.position_mm:.4f} mm" if self.tells_noise else "cannot be determined"
        return {"rows": f"{self.kept.sum()} of {len(self.rows)}", "errors": f"{before:.4f} mm before, {after:.4f} after", "noise": scatter}

    def to_frame(self) -> DataFrame:
        """Every unknown with its value and standard uncertainty, in the units of the names."""
        unknowns, u = self.fit.problem.unknowns, np.sqrt(np.diag(self.fit.covariance))
        return framed({"name": unknowns.names, "value": unknowns.values(self.fit.x), "u": u})

    @property
    def kept(self) -> BoolArray:
        """(N,) whether a row was used."""
        return np.asarray(self.mean_of >= 0)

    @property
    def stays(self) -> int:
        """Return how many stays of the robot the used rows were measured at."""
        return len(np.unique(self.fit.problem.rows.stay))

    @property
    def weight(self) -> FloatArray:
        """(N,) with which every row counts, from 0 to 1."""
        out = self.kept.astype(np.float64)
        if self.fit.problem.weight is not None:
            out[self.kept] = self.fit.problem.weight[self.mean_of[self.kept]]
        return out

    @property
    def noise(self) -> Noise:
        """Return the robot's own noise."""
        return self.fit.problem.noise

    @property
    def tells_noise(self) -> bool:
        """Return whether the residuals determine it: more of them than unknowns."""
        return self.fit.spare >= LEAST_SPARE

    @property
    def shape(self) -> FloatArray:
        """(3, 3) shape of errors of places in the instrument's frame, of trace 3: they are larger about some axes than about others."""
        fit = self.fit
        used = fit.problem.rows.placed
        errors = fit.at.residuals[used, POSITION]
        if len(errors) < ENOUGH:
            return np.eye(3)
        spread = (errors if fit.problem.weight is None else errors * fit.problem.weight[used, None]).T @ errors
        return np.asarray(3.0 * spread / np.trace(spread))

    def of_robot(self, rows: Measurements) -> FloatArray:
        """Return the (N, 3, 3) [mm²] covariance of the robot's own noise at the rows' targets: its shift, and its turn about the mean of
        the targets if stays have several."""
        out = np.tile(self.noise.position_mm**2 * self.shape, (len(rows), 1, 1))
        if self.fit.problem.several:
            middle = self.state.targets[self.fit.problem.rows.target_of, :3].mean(axis=0)
            turn = se3.matrices(se3.compose(self.state.base, self.state.robot.forward(rows.joints)))
            arm = np.cross(np.eye(3)[None], (turn @ (self.state.targets[rows.target_of, :3] - middle)[:, :, None])[:, None, :, 0])
            out = out + self.noise.rotation_rad**2 * (arm @ np.swapaxes(arm, 1, 2))
        return np.asarray(out)

    @property
    def robot_mm(self) -> float:
        """Return the robot's noise in each coordinate of its first target, as a standard deviation."""
        row = self.fit.problem.rows.of(np.array([0]))
        return float(np.sqrt(np.trace(self.of_robot(replace(row, target_of=np.zeros(1, dtype=np.int64)))[0]) / 3.0))

    def errors_mm(self) -> FloatArray:
        """(N, 3) measured minus predicted places of all rows [mm, instrument's frame], without the errors of the instrument that all rows
        share, as they were estimated; NaN where none was measured."""
        shared = self.rows.systematic[:, POSITION] @ self.fit.x[self.fit.problem.unknowns.asked :]
        return np.asarray(self.rows.position - shared - self.state.predicted(self.rows)[:, :3])

    def nominal_errors_mm(self) -> FloatArray:
        """(N, 3) the same of the nominal robot, with the frames that fit it best."""
        return np.asarray(self.rows.position - self.nominal_state.predicted(self.rows)[:, :3])


@dataclass(frozen=True)
class Prediction:
    """pose (N, 7) instrument_from_target [mm]; covariance (N, 3, 3) [mm^2] of a new measurement's place minus that; u95_mm (N,): radius
    that holds 95 % of such differences."""

    pose: FloatArray
    covariance: FloatArray
    u95_mm: FloatArray


def freed(robot: R, families: Sequence[str]) -> IntArray:
    """Indices of the robot's parameters in the families; RobotError names an unknown one, and those known."""
    unknown = [f for f in families if f not in (*FAMILIES, "harmonics")]
    if unknown:
        raise RobotError(message("error.is_nothing_that_can_be", unknown=unknown[0], names=", ".join((*FAMILIES, "harmonics"))))
    wanted = set(families) | ({"once", "twice"} if "harmonics" in families else set())
    return np.array([i for i, p in enumerate(robot.parameters) if family(p.name) in wanted], dtype=np.int64)


def widths(robot: R, settings: Settings) -> FloatArray | None:
    """(all parameters,) prior standard uncertainties where something is stated of how the robot was built, in the units of the names."""
    stated = {"mm": settings.u_links_mm, "deg": settings.u_links_deg}
    if stated["mm"] is None and stated["deg"] is None:
        return None
    of = [stated.get(p.unit) if family(p.name) == "links" else None for p in robot.parameters]
    return np.array([p.width if u is None else u for p, u in zip(robot.parameters, of, strict=True)])


def family(name: str) -> str:
    """Return the family of a parameter, by its name."""
    key = name.rsplit(".", 1)[-1]
    return next((f for f, ends in FAMILIES.items() if key in ends), "links")


def identify(robot: R, rows: Measurements, settings: Settings | None = None) -> Identified[R]:
    """Calibrate a robot's kinematic model from joint values and measured positions or poses.

    Parameters
    ----------
    robot
        Nominal robot.
    rows
        Measurements: joint values, targets, and measurements of the instrument.
    settings
        Effects that may be freed, priors and hold-out; by default `Settings()`.

    Returns
    -------
    Identified
        Parameters with covariance, the frames of robot and instrument, and errors at poses that were left out.

    Raises
    ------
    RobotError
        If there are too few rows to locate the robot, or their weights leave too few.

    Examples
    --------
    >>> from lmeasure.robots import read_measurements, read_robot
    >>> robot = read_robot("robot.toml")  # doctest: +SKIP
    >>> lm.identify(robot, read_measurements("measurements.csv", robot))  # doctest: +SKIP
    """
    settings = settings or Settings()
    rows, findings = _reached(robot, rows)
    if isinstance(robot, Parallel):
        robot = robot.remembering(rows.joints)
    stay = stays_of(rows.joints, robot.sliding)
    # all rows of a stay are on the side of a joint's play that its first row came from
    rows = replace(rows, stay=stay, side=rows.side[np.searchsorted(stay, stay)])
    kept = np.ones(len(rows), np.bool_)
    findings += _copies(rows, kept) + _named_alike(rows, np.flatnonzero(kept)) + _beyond_limits(robot, rows) + _unmoved(robot, rows)
    frames = find_frames(robot.forward(rows.joints, rows.side), rows, settings.seed)
    unknowns = Unknowns(robot, freed(robot, settings.free), frames, rows, widths=widths(robot, settings))
    read = read_at_stays(rows, agreeing(rows, kept) if settings.outliers or settings.weights == "biweight" else kept)
    findings += _scattered(read)
    rows = replace(rows, covariance=rows.covariance * np.repeat(np.maximum(read.times, 1.0), 3)[:, None])
    used = np.ones(len(read.rows), np.bool_)
    # rows that lie far from where the nominal robot could have been
    used[read.of[rows.placed & ~frames.used & (read.of >= 0)]] = False
    problem = Problem(
        unknowns, read.rows.of(np.flatnonzero(used)), _begin(read, frames, settings), settings.own_noise, scatter=read.scatter
    )
    fit = with_noise(problem, _begun(robot, unknowns, problem.rows))
    if settings.outliers:
        fit, used = without_outliers(fit, read.rows, used)
    if settings.weights == "biweight":
        fit, used = weighed(fit, read.rows, used)
    mean_of = np.where(read.of >= 0, np.where(used, np.cumsum(used) - 1, -1)[read.of], -1)
    findings += outlying(fit, rows, kept, mean_of >= 0)
    nominal = State(robot, frames.base, frames.targets, frames.stations)
    found = Identified(robot, fit, rows, mean_of, (), nominal, settings)
    findings += _doubted(found)
    if not fit.converged:
        findings.append(noted("not_converged", "not_converged"))
    if not settings.own_noise and scipy.stats.chi2.sf(fit.chi2, fit.freedom) < MISFIT:
        times = float(np.sqrt(fit.chi2 / fit.freedom))
        findings.append(noted("misfit", "misfit", value=times, times=times))
    if not found.tells_noise:
        findings.append(noted("underdetermined", "underdetermined", value=float(fit.equations), values=fit.equations))
    return replace(found, findings=tuple(findings))


def _begin(read: Stays, frames: Frames, settings: Settings) -> Noise:
    """The noise from which its size is looked for: the nominal robot's misfit, and the scatter of readings or a part of that."""
    if not settings.own_noise:
        return Noise(0.0, 0.0)
    rms = max(frames.rms_mm, LEAST_MM)
    turn, place = np.sqrt(read.scatter.variance)
    several = len(np.unique(read.rows.stay)) < len(read.rows)
    place, turn = (
        max(float(u) or 0.1 * size * several, least) for u, size, least in ((place, rms, LEAST_MM), (turn, rms / 1e3, LEAST_RAD))
    )
    stated = read.rows.stated
    return Noise(rms, rms / 1e3, 0.0 if stated[0] else place, 0.0 if stated[1] else turn)


def _begun(robot: R, unknowns: Unknowns[R], rows: Measurements) -> FloatArray:
    """Return initial values of the unknowns, in the units of their names: a mechanism's legs at the measured poses, else the nominal
    robot."""
    theta, whole = np.zeros(len(unknowns)), rows.placed & rows.oriented
    if isinstance(robot, Parallel) and whole.sum() >= LEAST_POSES:
        at, targets = np.column_stack([rows.position, rows.quaternion])[whole], unknowns.start.targets[rows.target_of[whole]]
        flange = se3.compose(se3.compose(se3.inverse(unknowns.start.base), at), se3.inverse(targets))
        found = legs_at(robot, flange, rows.joints[whole], unknowns.freed)
        if not np.isnan(robot.moved(found).forward(rows.joints)).any():
            theta[: len(unknowns.freed)] = found[unknowns.freed] / unknowns.size[: len(unknowns.freed)]
    return theta


def check_foreign(found: Identified[R]) -> None:
    """RobotError where the identified robot misses the rows by so much of their spread that they are not measurements of it."""
    rows, kept = found.rows, found.kept & found.rows.placed
    if kept.any():
        errors, spread = found.errors_mm()[kept], rows.position[kept] - rows.position[kept].mean(axis=0)
    else:
        kept = found.kept & rows.ranged
        errors = found.fit.problem.unknowns.residuals(found.fit.x, rows)[kept, LENGTH]
        spread = rows.length_mm[kept] - rows.length_mm[kept].mean()
    off, size = (float(np.sqrt((part**2).sum() / max(len(part), 1))) for part in (errors, spread))
    if off > FOREIGN * size:
        raise RobotError(message("error.the_identified_robot_still", off=off, size=size))


def predict(
    found: Identified[R],
    joints: FloatArray,
    target: IntArray | None = None,
    side: FloatArray | None = None,
    *,
    u_position_mm: float | None = None,
) -> Prediction:
    """Predict the measured position of a target at joint values (M, n), with the radius that holds 95 % of new measurements there.

    The uncertainty is that of the identification, of the robot itself, and of the instrument, widened for errors of the model
    (`Identified.misfit`): u_position_mm of each coordinate, by default the median of the measurements' statements. target (M,): indices of
    targets, by default the first.
    """
    rows = measured(joints, side=np.zeros_like(joints) if side is None else side)
    rows = replace(
        rows, targets=found.rows.targets, target_of=rows.target_of if target is None else target, position=np.zeros((len(rows), 3))
    )
    if u_position_mm is None:
        stated = np.einsum("nii->ni", found.rows.covariance) + (found.rows.systematic**2).sum(axis=2)
        instrument = float(np.median(stated[:, POSITION])) + found.noise.reading_mm**2
    else:
        instrument = u_position_mm**2
    return predicted(found, rows, instrument * np.eye(3))


def predicted(found: Identified[R], rows: Measurements, instrument: FloatArray) -> Prediction:
    """`predict` of the rows' joint values and targets, with the instrument's covariance (3, 3) or (M, 3, 3) [mm^2]."""
    unknowns, fit = found.fit.problem.unknowns, found.fit
    _, jacobian = unknowns.linearised(fit.x, rows)
    jacobian = (jacobian * unknowns.size)[:, POSITION]
    known = found.beyond.places(jacobian, fit.covariance)
    robot = found.of_robot(rows)
    covariance = found.misfit**2 * (known + robot + instrument)
    # the noise has the degrees of freedom of the residuals, except the stated part of the instrument
    own = np.einsum("nii->n", robot)
    estimated = own / np.maximum(own + np.trace(instrument, axis1=-2, axis2=-1), 1e-300) if found.rows.stated[0] else 1.0
    wider = 1.0 + estimated * float(scipy.stats.t.ppf(0.975, fit.freedom) / scipy.stats.t.ppf(0.975, np.inf) - 1.0)
    return Prediction(found.state.predicted(rows), covariance, wider * radii_95(covariance))


def _reached(robot: R, rows: Measurements) -> tuple[Measurements, list[Noted]]:
    """The rows whose joint values lead to a pose; the others are named and left out. RobotError where none does."""
    lost = np.isnan(robot.forward(rows.joints, rows.side)).any(axis=1)
    found = [noted("row-out-of-reach", "no_pose", rows.names[i], row=rows.subject(i)) for i in np.flatnonzero(lost).tolist()]
    if lost.all():
        raise RobotError(message("error.and_all_others_no", subject=rows.subject(0), name=robot.name))
    if len(rows) > 1 and not np.ptp(rows.joints, axis=0).any():
        raise RobotError(message("error.all_rows_have_the", n_rows=len(rows)))
    return (rows.of(np.flatnonzero(~lost)) if lost.any() else rows), found


def _copies(rows: Measurements, kept: BoolArray) -> list[Noted]:
    out = []
    for row, earlier in repeated(rows):
        kept[row] = False
        out.append(noted("duplicate", "duplicate", rows.names[row], row=rows.subject(row), earlier=rows.subject(earlier)))
    return out


def _named_alike(rows: Measurements, of: IntArray) -> list[Noted]:
    """Names that several rows have: the first of them, and how many more; of repetitions how far they are apart at most."""
    moved, again = named_alike(rows, of)
    out = []
    if moved:
        row, earlier = moved[0]
        said = {"row": rows.subject(row), "earlier": rows.subject(earlier), "count": len(moved)}
        out.append(noted("same-name", "same_name.joints", rows.names[row], float(len(moved)), **said))
    if again:
        many, one = np.array(again).T
        apart = np.linalg.norm(rows.position[many] - rows.position[one], axis=1)
        lengths = np.abs(rows.length_mm[many] - rows.length_mm[one])
        off = np.where(np.isnan(apart), lengths, apart)
        worst = int(np.argmax(off))
        row, earlier = again[worst]
        said = {"row": rows.subject(row), "earlier": rows.subject(earlier), "count": len(again), "off_mm": float(off[worst])}
        out.append(noted("same-name", "same_name.repeated", rows.names[row], float(off[worst]), **said))
    return out


def _unmoved(robot: R, rows: Measurements) -> list[Noted]:
    """Report joints that never moved: the measurements contain nothing about their other values."""
    out = []
    for j in np.flatnonzero(_still(robot, rows.joints)).tolist():
        value, unit = joint_value(robot, j, rows.joints[0, j])
        out.append(noted("joint-unmoved", f"unmoved.{unit}", robot.joint_names[j], value, joint=robot.joint_names[j], at=value))
    return out


def unmoved_in(found: Identified[R], joints: FloatArray, u95_mm: FloatArray, file: str) -> list[Noted]:
    """Joints that never moved in the measurements and have other values in rows (M, n), with the largest of their u95 (M,)."""
    out = []
    for j in np.flatnonzero(_still(found.nominal, found.rows.joints)).tolist():
        away = np.abs(joints[:, j] - found.rows.joints[0, j]) > (UNMOVED_MM if found.nominal.sliding[j] else np.radians(UNMOVED_DEG))
        if away.any():
            name, most = found.nominal.joint_names[j], float(u95_mm[away].max())
            said = {"file": file, "joint": name, "count": int(away.sum()), "u95_mm": most}
            out.append(noted("joint-unmoved", "unmoved.asked", name, most, **said))
    return out


def _still(robot: R, joints: FloatArray) -> BoolArray:
    """(n,) which joints have the same value in all rows (N, n)."""
    return np.asarray(np.ptp(joints, axis=0) <= np.where(robot.sliding, UNMOVED_MM, np.radians(UNMOVED_DEG)))


def _scattered(read: Stays) -> list[Noted]:
    """Report readings of one stay with a larger scatter than stated."""
    turn, place = np.sqrt(read.times)
    times = float(max(turn, place))
    return [noted("readings", "readings", value=times, times=times)] if times > 1.0 else []


def _beyond_limits(robot: R, rows: Measurements) -> list[Noted]:
    low, high = robot.limits
    beyond = (rows.joints < low - 1e-9) | (rows.joints > high + 1e-9)
    out = []
    for j in np.flatnonzero(beyond.any(axis=0)):
        row = int(np.argmax(beyond[:, j]))
        value, unit = joint_value(robot, int(j), rows.joints[row, j])
        count = int(beyond[:, j].sum())
        joint, first = robot.joint_names[j], rows.subject(row)
        out.append(noted("limits", f"limits.{unit}", joint, value, joint=joint, count=count, row=first, at=value))
    return out


def _doubted(found: Identified[R]) -> list[Noted]:
    """Rows that count for less than half, those that count least first."""
    weight = found.weight
    few = np.flatnonzero(found.kept & (weight < HALF))
    rows = tuple(
        message("identify.row_weight", row=found.rows.subject(i), weight=float(weight[i])) for i in few[np.argsort(weight[few])].tolist()
    )
    return [noted("down-weighted", "down_weighted", value=float(len(few)), count=len(few), rows=rows)] if len(few) else []
