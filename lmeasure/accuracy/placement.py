"""Search for the positions of observation and attachment points that measure best where the robot works."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import scipy
from pydantic import Field, model_validator
from scipy.spatial.transform import Rotation

from lmeasure import kernels
from lmeasure.accuracy.scan import digest_of, run
from lmeasure.accuracy.zone import assumed_in_zone, axis, dimension_variance, make_plan, tilts
from lmeasure.core import AccuracyError, DataFrame, FloatArray, Shown, framed
from lmeasure.io import Strict, Whole, checked, files
from lmeasure.rig import Rig
from lmeasure.sensors import length_variance
from lmeasure.text import Lines, message
from lmeasure.trajectory import Assumed

Progress = Callable[[int, int], None]
Vector = tuple[float, float, float]

SCHEMA = "lmeasure.placement/1"
POPULATION = 90
SAMPLE_BITS = 10  # of the Sobol sample from which a population is taken
ROUNDS = 8  # searches from other samples; one may settle a few degrees above another
FINALISTS = 3  # best candidates that continue with the mounting tolerance
ROBUST_BITS = 4
GENERATIONS = 2000
EVOLUTION: dict[str, Any] = {"mutation": (0.4, 0.9), "recombination": 0.85, "tol": 1e-4, "polish": False}
EVOLUTION |= {"vectorized": True, "updating": "deferred"}
LOCAL_CALLS = 2000
BROKEN_MM = 0.1  # of a rule that the search may leave to rounding and to the fitter
BROKEN_PER_MM = 0.02  # cost of a millimetre across a rule: ten times the largest gain of a millimetre [rad, or relative radius]


class Box(Strict):
    """Box with edges along the axes of its frame."""

    low_mm: Vector
    """Corner with the smallest coordinates."""
    high_mm: Vector
    """Corner with the largest coordinates."""

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if any(a > b for a, b in zip(self.low_mm, self.high_mm, strict=True)):
            raise ValueError(message("error.low_mm_must_not"))
        return self


class Where(Box):
    """Box for the named points; flat for a surface. Base frame for observation points, tool frame for attachment points."""

    points: Annotated[tuple[str, ...], Field(min_length=1)]
    """Names of the points that can be placed in the box."""


class Work(Box):
    """Task of the robot: box of tool origins, base frame, with tilts about an orientation. All limits apply throughout."""

    nodes: Annotated[Whole, Field(ge=2, le=20)] = 3
    """Evaluated positions along each edge."""
    tilt_rad: Annotated[float, Field(ge=0, le=math.pi)] = 0.0
    """Largest component of the rotation vectors of the tilts."""
    tilt_steps: Annotated[Whole, Field(ge=1, le=20)] = 3
    """Equal steps from -tilt to +tilt; 1: no tilt."""
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    """Orientation base_from_tool before the tilts."""


class Placement(Strict):
    """Task, and boxes for the points to place; input of `lmeasure place --task`."""

    schema_: Annotated[Literal["lmeasure.placement/1"], Field(alias="schema")] = "lmeasure.placement/1"
    """Kind and version of the file."""
    objective: Literal["pressure_angle", "u95"] = "pressure_angle"
    """Quantity to minimise at the task: largest pressure angle, or largest expanded uncertainty U95 of the position."""
    tolerance_mm: Annotated[float, Field(ge=0, le=1000)] = 0.0
    """Mounting tolerance of a point per axis; the search optimises the worst case within it."""
    length_mm: tuple[float, float] | None = None
    """Shortest and longest allowed cable at the task."""
    task: Work
    """Task of the robot."""
    mount: tuple[Where, ...] = ()
    """Boxes for observation points, base frame."""
    attachment: tuple[Where, ...] = ()
    """Boxes for attachment points, tool frame."""
    keep_out: tuple[Box, ...] = ()
    """Boxes without observation points, base frame."""


def read_placement(path: Path) -> Placement:
    """Read a placement file; FileFormatError names the file and the key."""
    return checked(files.read_toml(path), Placement, str(path))


@dataclass(frozen=True, repr=False)
class Placed(Shown):
    """Result of a search: the rig, the worst figures at the task before and after, the sensitivity to a millimetre at each coordinate.

    before, after: worst_pressure_angle_deg, u95_position_mm, robust_pressure_angle_deg (the worst within the mounting tolerance),
    shortest_cable_mm, longest_cable_mm; sensitivity: per point the change of the worst angle [deg] by one millimetre along x, y, z.
    """

    rig: Rig
    before: dict[str, float]
    after: dict[str, float]
    sensitivity: dict[str, tuple[float, float, float]]
    evaluations: int
    assumed: Assumed = field(default_factory=Assumed)
    """Part of typical sizes that are not stated in U95 at the task after the search."""

    def about(self) -> dict[str, str]:
        """The worst figures at the task, before and after."""
        return {name: f"{self.before[name]:.4g} -> {after:.4g}" for name, after in self.after.items()}

    def to_frame(self) -> DataFrame:
        """The worst figures at the task, before and after."""
        return framed({"before": self.before, "after": self.after})

    def summary(self) -> str:
        """A few lines for a person."""
        b, a = self.before, self.after
        angles = {"was": b["worst_pressure_angle_deg"], "now": a["worst_pressure_angle_deg"], "robust": a["robust_pressure_angle_deg"]}
        cables = {"least": a["shortest_cable_mm"], "most": a["longest_cable_mm"], "count": self.evaluations}
        u95 = message("accuracy.worst_95_radius_mm", was=b["u95_position_mm"], now=a["u95_position_mm"], **cables)
        lines = [message("accuracy.worst_pressure_angle_task", **angles), u95]
        name, most = max(self.sensitivity.items(), key=lambda item: max(map(abs, item[1])))
        lines.append(message("accuracy.most_sensitive_point_deg", point=name, change=max(map(abs, most))))
        return Lines([*lines, *self.assumed.lines])


class Search:
    """Search over the free coordinates of rigs, and the figures of each rig at the task."""

    def __init__(self, rig: Rig, wanted: Placement) -> None:
        if not rig.sensors:
            rig.require_pose(redundant=True)
        self.rig, self.wanted = rig, wanted
        self.free = [(kind, name, where) for kind in ("mount", "attachment") for where in getattr(wanted, kind) for name in where.points]
        self._check()
        self.low = np.array([where.low_mm for _, _, where in self.free]).ravel()
        self.high = np.array([where.high_mm for _, _, where in self.free]).ravel()
        task = wanted.task
        spans = [axis(a, b, (b - a) / (task.nodes - 1)) if b > a else np.array([a]) for a, b in zip(task.low_mm, task.high_mm, strict=True)]
        self.nodes = np.array(list(itertools.product(*spans)))
        self.positions = np.concatenate([self.nodes, np.repeat(self.nodes[-1:], -len(self.nodes) % kernels.LANES, axis=0)])
        self.centre = 0.5 * (np.array(task.low_mm) + np.array(task.high_mm))
        turns = tilts(task.tilt_rad, task.tilt_steps, Rotation.from_quat(task.quaternion_xyzw))
        self.turns, self.start = turns, np.array([*self.centre, *task.quaternion_xyzw])
        # the search takes the errors of dimensions as they are on average at the present rig, the result as they are
        plan = make_plan(rig, None, self.positions, turns, start=self.start)
        more = dimension_variance(plan)
        channels = plan.channels and replace(plan.channels, drums=plan.channels.drums + np.pad(more, (0, len(rig.observed) - len(more))))
        self.plan = replace(plan, variance=plan.variance + more, channels=channels)
        self.rows, self.evaluations = rig.cable_rows(rig.observed), 0
        # channels with an observation point and a guide
        self.led = np.isin(self.rows[:, kernels.KIND], (kernels.CABLE, kernels.SWIVEL))
        toward = self.centre - self.rows[self.led, kernels.BASE_XYZ]
        self.toward = toward / np.linalg.norm(toward, axis=1)[:, None]
        self.keep_out = np.array([(box.low_mm, box.high_mm) for box in wanted.keep_out]).reshape(-1, 2, 3)
        self.mounted = np.array([kind == "mount" for kind, _, _ in self.free])
        # rows of the channels that each free point moves
        ends = [("from_point" if kind == "mount" else "to_point", name) for kind, name, _ in self.free]
        self.moves = [[j for j, o in enumerate(rig.observed) if getattr(o, end) == name] for end, name in ends]

    def _check(self) -> None:
        if not self.free:
            raise AccuracyError(message("error.placement_neither_mount_nor"))
        points, tool = {p.name for p in self.rig.observation_point}, set(self.rig.tool)
        seen: set[tuple[str, str]] = set()
        for kind, name, _ in self.free:
            known = points if kind == "mount" else tool
            if name not in known:
                others = ", ".join(sorted(known))
                raise AccuracyError(message("error.placement_is_no_point", kind=kind, name=name, name2=self.rig.name, known=others))
            if (kind, name) in seen:
                raise AccuracyError(message("error.placement_is_placed_twice", kind=kind, name=name))
            seen.add((kind, name))

    def current(self) -> FloatArray:
        """The rig's own free coordinates, (3 f,) [mm], inside the boxes or not."""
        values = [self.rig.point(name).position_mm if kind == "mount" else self.rig.tool[name] for kind, name, _ in self.free]
        return np.array(values, dtype=np.float64).ravel()

    def channels(self, x: FloatArray) -> FloatArray:
        """(n, m, columns) kernel rows of (n, 3 f) candidates; a guide turns with its point: its pulley is wrapped as before."""
        out = np.repeat(self.rows[None], len(x), axis=0)
        for f, rows in enumerate(self.moves):
            for j in rows:
                columns = kernels.BASE_XYZ if self.mounted[f] else kernels.ATTACHMENT_XYZ
                out[:, j, columns] = x[:, 3 * f : 3 * f + 3]
        led = self.led
        toward = self.centre - out[:, led, kernels.BASE_XYZ]
        toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
        guides = _carried(self.toward[None], toward, self.rows[None, led, kernels.GUIDE_XYZ])
        u_x, u_y, u_z = np.moveaxis(guides, -1, 0)
        out[:, led, kernels.GUIDE_XYZ] = guides
        out[:, led, kernels.ALPHA], out[:, led, kernels.BETA] = np.arcsin(np.clip(u_z, -1, 1)), np.arctan2(-u_x, -u_y)
        return out

    def figures(self, x: FloatArray, known: FloatArray | None = None) -> FloatArray:
        """(n, 4) worst squared speed, 95 % radius [mm], shortest and longest cable [mm] of (n, 3 f) candidates over the task; of one whose
        objective is above its known value, over a part of the task."""
        self.evaluations += len(x)
        plan, rows = self.plan, self.channels(x)
        if plan.channels is not None:
            # each reading by its own variance, zeros included
            variance = np.ascontiguousarray(np.diag(plan.channels.V))
            own = variance + plan.channels.drums
            return np.asarray(kernels.worst_of_channels(rows, len(plan.cables), self.nodes, plan.quaternions, variance, own))
        limits = np.full((len(x), 2), np.inf)
        if known is not None:
            angle = self.wanted.objective == "pressure_angle"
            # rounding must not reject an equal one
            with np.errstate(over="ignore"):
                limit = 1.0 / np.cos(np.minimum(known, 0.5 * math.pi)) ** 2 if angle else np.exp(known)
            limits[:, 0 if angle else 1] = np.where(limit < 1e9, limit * (1.0 + 1e-9), np.inf)
        law = plan.quaternions, plan.variance, plan.weights, plan.order
        return np.asarray(kernels.worst_at_task(rows, self.positions, *law, limits))

    def worth(self, x: FloatArray, known: FloatArray | None = None) -> FloatArray:
        """(n,) objective, the smaller the better: worst angle [rad] or logarithm of the worst radius, and a cost for broken rules. known
        (n,): values above which a candidate is rejected; one that is above gets any value above, as soon as this is certain."""
        figures = self.figures(x, known)
        return self.value(figures) + BROKEN_PER_MM * self.broken(x, figures[:, 2], figures[:, 3])

    def best_of(self, sample: FloatArray, count: int) -> FloatArray:
        """Return the best candidates of a sample, best first."""
        some = self.worth(sample[: 2 * count])
        others = sample[2 * count :]
        rest = self.worth(others, np.full(len(others), np.sort(some)[count - 1]))
        return sample[np.argsort(np.concatenate([some, rest]))[:count]]

    def value(self, figures: FloatArray) -> FloatArray:
        """Return the (n,) objective of figures (n, 4), without the penalty for broken rules."""
        speed2, u95 = figures[:, 0], figures[:, 1]
        return np.asarray(np.arccos(1.0 / np.sqrt(speed2)) if self.wanted.objective == "pressure_angle" else np.log(np.minimum(u95, 1e9)))

    def broken(self, x: FloatArray, shortest: FloatArray, longest: FloatArray) -> FloatArray:
        """(n,) millimetres by which candidates break the cable lengths and the keep-outs, with the mounting tolerance as a margin."""
        out, margin = np.zeros(len(x)), math.sqrt(3.0) * self.wanted.tolerance_mm
        if self.wanted.length_mm:
            least, most = self.wanted.length_mm
            # a cable that cannot run has no length
            out += np.maximum(0, least + margin - np.where(np.isfinite(shortest), shortest, 0.0)) + np.maximum(0, longest - most + margin)
        points = x.reshape(len(x), -1, 3)[:, self.mounted]
        for low, high in self.keep_out:
            depth = np.minimum(points - low, high - points).min(axis=-1)
            out += np.maximum(0, depth + self.wanted.tolerance_mm).sum(axis=-1)
        return out

    def around(self, x: FloatArray, draws: FloatArray) -> float:
        """The worst objective within the mounting tolerance of one candidate; its rules hold the tolerance as a margin already."""
        figures = self.figures(np.concatenate([x[None], x[None] + draws]))
        broken = self.broken(x[None], figures[:1, 2], figures[:1, 3])[0]
        return float(self.value(figures).max() + BROKEN_PER_MM * broken)


def _carried(old: FloatArray, new: FloatArray, vectors: FloatArray) -> FloatArray:
    """Vectors turned by the smallest rotation that takes the unit direction old to new."""
    cross = np.cross(old, new)
    cosine = (old * new).sum(axis=-1, keepdims=True)
    along = (cross * vectors).sum(axis=-1, keepdims=True)
    # Rodrigues with sin and cos from the two directions; opposite ones leave the axis open, and any will do
    turned = cosine * vectors + np.cross(cross, vectors) + cross * along / np.maximum(1.0 + cosine, 1e-9)
    return np.asarray(turned / np.linalg.norm(turned, axis=-1, keepdims=True))


def place(rig: Rig, wanted: Placement, seed: int = 0, progress: Progress | None = None, *, generations: int = GENERATIONS) -> Placed:
    """Search the free points for the best worst figure at the task.

    Rounds of differential evolution from the best of a Sobol sample (the present rig among the first) over the boxes, each until its
    population agrees or the generations are used up; the best of them continue with Powell's directions, on the worst within the mounting
    tolerance. The same seed gives the same result. AccuracyError when no candidate keeps the rules.
    """
    search = Search(rig, wanted)
    bounds = [(low, max(high, low + 1e-9)) for low, high in zip(search.low, search.high, strict=True)]
    start = np.clip(search.current(), search.low, search.high)
    done = 0
    known: FloatArray | None = None

    def determined(intermediate_result: scipy.optimize.OptimizeResult) -> None:
        nonlocal done, known
        # each candidate of the next generation replaces the one at its place, or is worse and forgotten
        known = intermediate_result.population_energies.copy()
        done += 1
        if progress:
            progress(done, ROUNDS * generations)

    def worth(x: FloatArray) -> FloatArray:
        return search.worth(np.ascontiguousarray(x.T), known)

    results = []
    for number, stream in enumerate(np.random.SeedSequence(seed).spawn(ROUNDS)):
        random = np.random.default_rng(stream)
        sample = scipy.stats.qmc.scale(scipy.stats.qmc.Sobol(len(bounds), rng=random).random_base2(SAMPLE_BITS), *np.transpose(bounds))
        population, known = search.best_of(sample, POPULATION), None
        if number == 0:
            population[-1] = start
        own = {"maxiter": generations, "init": population, "rng": random, "callback": determined}
        results.append(scipy.optimize.differential_evolution(worth, bounds, **EVOLUTION, **own))
        done = (number + 1) * generations
    draws = mounting_draws(search, seed)
    finalists = [_local(search, r.x, draws) for r in sorted(results, key=lambda r: r.fun)[:FINALISTS]]
    best = min(finalists, key=lambda x: search.around(x, draws))
    _, _, shortest, longest = search.figures(best[None]).T
    if search.broken(best[None], shortest, longest)[0] > BROKEN_MM:
        raise AccuracyError(message("error.placement_no_places_were"))
    before, after = search.current(), best
    found = _rig_at(search, best)
    quality = _figures_at(search, before, draws), _figures_at(search, after, draws)
    worst = np.tile(search.nodes[np.argmax(_u95_mm(search, found))], (len(search.turns), 1))
    assumed = assumed_in_zone(found, None, worst, search.turns, start=search.start, share=1.0)
    return Placed(found, *quality, _sensitivity(search, after), search.evaluations, assumed)


def mounting_draws(search: Search, seed: int) -> FloatArray:
    """(n, 3 f) displacements of the free points [mm]: corners of the mounting tolerance, none without one."""
    tolerance = search.wanted.tolerance_mm
    if tolerance == 0.0:
        return np.zeros((0, len(search.low)))
    corners = scipy.stats.qmc.Sobol(len(search.low), rng=np.random.default_rng(seed + 1)).random_base2(ROBUST_BITS)
    return np.where(np.repeat(search.mounted, 3), tolerance * np.sign(corners - 0.5), 0.0)


def _local(search: Search, x: FloatArray, draws: FloatArray) -> FloatArray:
    """Powell's directions within the boxes, on the worst within the mounting tolerance."""
    bounds = [(low, max(high, low + 1e-9)) for low, high in zip(search.low, search.high, strict=True)]
    options = {"xtol": 1e-4, "ftol": 1e-7, "maxfev": LOCAL_CALLS}
    found = scipy.optimize.minimize(lambda y: search.around(np.asarray(y), draws), x, method="Powell", bounds=bounds, options=options)
    return np.asarray(found.x if found.fun <= search.around(x, draws) else x)


def _figures_at(search: Search, x: FloatArray, draws: FloatArray) -> dict[str, float]:
    speed2, u95, shortest, longest = (float(v) for v in search.figures(x[None])[0])
    if search.plan.factor.shape[1]:
        u95 = float(_u95_mm(search, _rig_at(search, x)).max())
    robust = float(search.figures(np.concatenate([x[None], x[None] + draws]))[:, 0].max())
    angles = {"worst_pressure_angle_deg": _angle(speed2), "robust_pressure_angle_deg": _angle(robust)}
    return angles | {"u95_position_mm": u95, "shortest_cable_mm": shortest, "longest_cable_mm": longest}


def _u95_mm(search: Search, rig: Rig) -> FloatArray:
    """(n,) worst U95 of the position at each node of the task, of all that a zone includes."""
    return run(make_plan(rig, None, search.nodes, search.turns, start=search.start))[0][kernels.FIGURES.index("u95_position")]


def _angle(speed2: float) -> float:
    return math.degrees(math.acos(1.0 / math.sqrt(speed2)))


def _sensitivity(search: Search, x: FloatArray) -> dict[str, tuple[float, float, float]]:
    """Change of the worst angle [deg] by one millimetre; the larger of the two directions, as a worst case has a kink at its best."""
    here = _angle(float(search.figures(x[None])[0, 0]))
    steps = np.eye(len(x))
    ahead = [_angle(float(v)) - here for v in search.figures(x + steps)[:, 0]]
    behind = [_angle(float(v)) - here for v in search.figures(x - steps)[:, 0]]
    worst = np.where(np.abs(ahead) >= np.abs(behind), ahead, behind).reshape(-1, 3)
    return {name: (float(w[0]), float(w[1]), float(w[2])) for (_, name, _), w in zip(search.free, worst, strict=True)}


def _rig_at(search: Search, x: FloatArray) -> Rig:
    """The rig with its free points at x and its guides turned along; a calibration of the old places is not kept."""
    rig = search.rig
    places = {(kind, name): tuple(float(v) for v in x[3 * f : 3 * f + 3]) for f, (kind, name, _) in enumerate(search.free)}
    rows = search.channels(x[None])[0]
    guides = {c.from_point: (math.degrees(rows[j, kernels.ALPHA]), math.degrees(rows[j, kernels.BETA])) for j, c in enumerate(rig.cable)}
    points = []
    for p in rig.observation_point:
        if ("mount", p.name) in places:
            alpha, beta = guides.get(p.name, (p.guide_alpha_deg, p.guide_beta_deg))
            update = {"position_mm": places["mount", p.name], "guide_alpha_deg": alpha, "guide_beta_deg": beta}
            points.append(p.model_copy(update=update))
        else:
            points.append(p)
    tool = {name: places.get(("attachment", name), at) for name, at in rig.tool.items()}
    return rig.model_copy(update={"observation_point": tuple(points), "tool": tool, "calibration": None})


def placement_record(placed: Placed, seed: int) -> dict[str, Any]:
    """Return the content of placement.json."""
    return {
        "schema": SCHEMA,
        "seed": seed,
        "evaluations": placed.evaluations,
        "before": placed.before,
        "after": placed.after,
        "assumed": placed.assumed.figures(),
        "sensitivity_deg_per_mm": placed.sensitivity,
        "rig_sha256": digest_of({"cables": placed.rig.cable_rows(), "variance": length_variance(placed.rig)}),
    }
