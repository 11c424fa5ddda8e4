"""Platforms on legs of any kinds (`legs.KINDS`), six equations together, as robots: poses of joint values, derivatives, inverse.

With the unit direction d of an equation, a leg's or a plane's normal, and a twist (omega; v) at the base's origin,

    (a x d ; d) . twist = -d . (R db) + d . dc - dn . (a - c) + dl

for changes db of the point on the platform and dc, dn, dl of the leg: all derivatives follow from the six rows on the left. The pose of
joint values is the one that is reached from home by driving the joints there steadily, through no singular pose: no other assembly. The
path is taken in strides, and gaps shorter than a stride are skipped. In workspaces of the shipped mechanisms, strides a twentieth as long
led to the same poses, all of them (`tests/robots/test_laws_over_workspaces.py`).

An identification of all legs together begins with each by itself (`legs_at`). At a measured pose a leg's equation contains no other leg,
like that of an SS dyad (source 004): its point on the platform, its lower end and its length are fitted to the poses alone, without the
forward problem, which a robot far from its nominal dimensions may not even have. A dyad's sphere is a carriage's, a crank's or a strut's
surface here, moved by its joint; all is least squares from the nominal values, with their uncertainties as priors.

A x' + B q' = 0 with A = dF/dx (m, f) and B = dF/dq (m, n). Where B loses rank a drive is at a dead point and the output at a limit (type
1); where A does, the output moves although the drives are fixed (type 2); both at once is type 3 (Gosselin and Angeles, Singularity
analysis of closed-loop kinematic chains, IEEE Transactions on Robotics and Automation 6, 1990). A determinant has the units of its columns
and does not measure the distance: rank is judged by singular values of matrices whose rows are of length one in stated units.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntFlag
from functools import cached_property
from itertools import product
from typing import NamedTuple, Self

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray, RobotError, Status, se3
from lmeasure.kernels import driven, placed
from lmeasure.robots.model import Limits, Parameter, joint_value, nearest_turns
from lmeasure.robots.parallel.legs import Leg
from lmeasure.text import message, numbers

NEARLY_SINGULAR = 1e-6
"""Smallest singular value over the largest under which a matrix is singular."""


class Singular(IntFlag):
    """Singular Jacobians: `OUTPUT` alone is type 2, `DRIVES` alone type 1, both type 3."""

    NO = 0
    DRIVES = 1
    OUTPUT = 2
    BOTH = 3


class Jacobians(NamedTuple):
    """output (..., m, f) is dF/dx, drives (..., m, n) is dF/dq; m equations."""

    output: FloatArray
    drives: FloatArray


def nearness(matrices: FloatArray, units: FloatArray | float = 1.0) -> FloatArray:
    """(...) smallest over largest singular value of matrices (..., m, f), columns multiplied by units (f,) and rows then of length one.

    units makes turns and shifts comparable: a length in which one radian is about as much as it. A row of zeros gives zero.
    """
    scaled = matrices * units
    size = np.linalg.norm(scaled, axis=-1, keepdims=True)
    values = np.linalg.svd(np.divide(scaled, size, out=np.zeros_like(scaled), where=size > 0.0), compute_uv=False)
    return np.asarray(values[..., -1] / np.maximum(values[..., 0], np.finfo(np.float64).tiny))


def singular(jacobians: Jacobians, output_units: FloatArray | float = 1.0) -> IntArray:
    """(...) `Singular` of mechanisms. Drives are of one kind, and judged by the rank of their columns beside the largest of them."""
    values = np.linalg.svd(jacobians.drives, compute_uv=False)
    drives = values[..., -1] <= NEARLY_SINGULAR * values[..., 0]
    output = nearness(jacobians.output, output_units) <= NEARLY_SINGULAR
    return np.asarray(Singular.DRIVES * drives + Singular.OUTPUT * output, dtype=np.int64)


def velocities(jacobians: Jacobians) -> FloatArray:
    """(..., f, n) V = -A^-1 B, which gives the output's twist of the drives' rates; NaN where the output is singular."""
    output, drives = jacobians
    if (singular(jacobians) & Singular.OUTPUT).any():
        return np.full((*output.shape[:-1], drives.shape[-1]), np.nan)
    return np.asarray(-np.linalg.solve(output, drives))


EQUATIONS = 6
STRIDE_RAD, STRIDE = 0.2, 0.1
"""Longest part of a way from home: of a turning joint, and of a sliding one in parts of the platform's size."""
MOST_PARTS = 400
BLOCK = 50_000
"""Parts of ways that are gone together: some 20 MB of equations."""
NEAR = 0.05
"""Largest distance between the poses of two hardly different robots at the same joint values, as a part of the platform's size."""
REACHED_MM = 1e-6
"""Largest error of a pose for the joint values of the inverse."""
MOST_RAD = np.pi / 2.0
"""Between samples of a followed path: a joint that turns farther has jumped."""
COMPONENTS = ("rx", "ry", "rz", "x", "y", "z")
"""Components of a displacement: turns about the platform's axes, shifts along the base's."""


@dataclass(frozen=True)
class Rows:
    """Legs at n poses: directions (n, 6, 3), points on the platform (n, 6, 3) and vectors to them (n, 6, 3) from the lower ends, base axes;
    pluecker (n, 6, 6) rows (moment; direction) at the base's origin."""

    directions: FloatArray
    places: FloatArray
    spans: FloatArray

    @property
    def pluecker(self) -> FloatArray:
        """Return the left side of the equation of derivatives."""
        return np.concatenate([np.cross(self.places, self.directions), self.directions], axis=-1)


@dataclass(frozen=True)
class PlatformLegs:
    """Lower ends (6, 3) and lengths (6,) [mm] that hold a platform; limits (6, 2) of the lengths where they are driven."""

    ends: FloatArray
    lengths: FloatArray
    limits: FloatArray | None


@dataclass(frozen=True)
class Parallel:
    """`RobotModel` of legs with six equations; home (7,): base_from_flange at the joint values home_joints (n,); commanded: the
    components of `COMPONENTS` that a robot of fewer than six joints is commanded in, the others follow; bounds: of its workspace besides
    its joints' limits; known: poses (7,) that a robot hardly different took at joint values, by their bytes (`remembering`)."""

    name: str
    legs: tuple[Leg, ...]
    home: FloatArray
    home_joints: FloatArray
    commanded: tuple[str, ...] = COMPONENTS
    bounds: Limits = field(default_factory=Limits)
    known: Mapping[bytes, FloatArray] = field(default_factory=dict, compare=False, repr=False)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(leg.name + end for leg in self.legs for end, _ in leg.of.drives)

    @cached_property
    def sliding(self) -> BoolArray:
        return np.array([slides for leg in self.legs for _, slides in leg.of.drives], dtype=np.bool_)

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        return np.concatenate([leg.low for leg in self.legs]), np.concatenate([leg.high for leg in self.legs])

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(p for leg in self.legs for p in leg.parameters)

    @property
    def reach_mm(self) -> float:
        return float("inf")

    @cached_property
    def size_mm(self) -> float:
        """Return the size of the platform [mm], the lever arm of a radian."""
        points = np.array([leg.point for leg in self.legs])
        return max(float(np.linalg.norm(points - points.mean(axis=0), axis=1).max()), 1.0)

    @cached_property
    def stride_mm(self) -> float:
        """Longest part of a way from home [mm]: where the platform follows a way of its own, some of its nodes."""
        ways = [2.0 * float(np.diff(leg.carried.x).mean()) for leg in self.legs if leg.kind == "way"]
        return min([STRIDE * self.size_mm, *ways])

    @cached_property
    def units(self) -> FloatArray:
        """(6,) turns and shifts that move the platform alike: for `jacobians.nearness`."""
        return np.array([1.0 / self.size_mm] * 3 + [1.0] * 3)

    @cached_property
    def owners(self) -> IntArray:
        """(6,) the leg of each equation."""
        at = np.split(self.home_joints, self._cuts)
        counts = [len(leg.equations(q[None])) for leg, q in zip(self.legs, at, strict=True)]
        return np.repeat(np.arange(len(self.legs)), counts)

    def held_by_lengths(self) -> "PlatformLegs | None":
        """Its six lengths with the drives standing as at home; None where an equation is of another kind."""
        equations = [e for leg, q in zip(self.legs, np.split(self.home_joints, self._cuts), strict=True) for e in leg.equations(q[None])]
        if any(e.normal is not None for e in equations):
            return None
        ends, lengths = (np.real(np.concatenate(part)) for part in list(zip(*equations, strict=True))[:2])
        limits = None
        if all(leg.kind == "strut" for leg in self.legs):
            limits = np.sort([[np.real(leg.equations(v[None])[0].length[0]) for v in (leg.low, leg.high)] for leg in self.legs], axis=1)
        return PlatformLegs(ends, lengths, limits)

    def moved(self, change: FloatArray) -> Self:
        cuts = np.cumsum([len(leg.parameters) for leg in self.legs])[:-1]
        return replace(self, legs=tuple(leg.moved(own) for leg, own in zip(self.legs, np.split(change, cuts), strict=True)))

    def forward(self, joints: FloatArray, side: FloatArray | None = None) -> FloatArray:
        joints = np.ascontiguousarray(joints, dtype=np.float64)
        poses, found = self._known(joints)
        if not found.all():
            poses[~found] = self._driven(joints[~found])
        return poses

    def remembering(self, joints: FloatArray) -> Self:
        """The robot, and those `moved` from it, with the poses at joint values (N, n) kept: where a slightly different robot begins."""
        joints = np.ascontiguousarray(joints, dtype=np.float64)
        poses = self.forward(joints)
        return replace(self, known={q.tobytes(): pose for q, pose in zip(joints, poses, strict=True) if not np.isnan(pose[0])})

    def _known(self, joints: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Poses (N, 7) from where they are known to have been, and whether they are known to be the same assembly."""
        kept = [self.known.get(q.tobytes()) for q in joints] if self.known else [None] * len(joints)
        of = np.flatnonzero([pose is not None for pose in kept])
        poses, good = np.full((len(joints), 7), np.nan), np.zeros(len(joints), np.bool_)
        if not len(of):
            return poses, good
        poses[of], good[of] = self.beside(joints[of], np.array([kept[i] for i in of]))
        return poses, good

    def beside(self, joints: FloatArray, starts: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return poses (N, 7) at joint values (N, n) found from poses starts (N, 7) of a moment before, and whether they are of the same
        assembly (N,): not far from there, and on home's side of singular poses, beyond which the nearest other one lies."""
        near, closed = self.near(joints, starts)
        here = np.where(closed[:, None], near, starts)
        away = np.abs(se3.displacement(here, starts) / self.units).max(axis=1)
        side = np.sign(np.linalg.det(self.rows(here, joints).pluecker * self.units))
        own = np.sign(np.linalg.det(self.rows(self.home[None], self.home_joints[None]).pluecker * self.units))
        return near, np.asarray(closed & (away < NEAR * self.size_mm) & (side == own))

    def _driven(self, joints: FloatArray) -> FloatArray:
        """`forward` along the whole way from home."""
        way = joints - self.home_joints
        strides = np.where(self.sliding, self.stride_mm, STRIDE_RAD)
        parts = np.maximum(np.ceil(np.abs(way / strides).max(axis=1)), 1.0)
        # NaN is no number of parts either
        some = np.flatnonzero(parts <= MOST_PARTS)
        poses = np.full((len(joints), 7), np.nan)
        for of in np.array_split(some, 1 + int(parts[some].sum()) // BLOCK):
            poses[of] = self._ends(way[of], parts[of].astype(np.int64))
        return poses

    def _ends(self, way: FloatArray, parts: IntArray) -> FloatArray:
        """(N, 7) poses behind changes (N, n) of the joints from home, each gone in so many even parts (N,); NaN where lost on the way."""
        first = 1 + np.concatenate([[0], np.cumsum(parts)])
        of = np.repeat(np.arange(len(parts)), parts)
        done = (np.arange(1, first[-1]) - (first[of] - 1)) / parts[of]
        drives = np.concatenate([self.home_joints[None], self.home_joints + done[:, None] * way[of]])
        status, poses = driven(*self._held(drives), first, self.home)
        return np.where((status == Status.OK)[:, None], poses, np.nan)

    def near(self, drives: FloatArray, starts: FloatArray) -> tuple[FloatArray, BoolArray]:
        """(N, 7) poses at drives (N, n) by Newton's method from starts (N, 7), in whichever assembly that leads to, and whether it did."""
        status, poses = placed(*self._held(drives), np.ascontiguousarray(starts))
        return poses, np.asarray(status == Status.OK)

    def residuals(self, poses: FloatArray, drives: FloatArray) -> FloatArray:
        """(N, 6) [mm] by how much equations are off at poses (N, 7) and drives (N, n)."""
        rows = self.rows(poses, drives)
        lengths = np.stack([length for _, length, _ in self._equations(drives)], axis=1)
        return np.asarray(np.einsum("nic,nic->ni", rows.directions, rows.spans) - lengths)

    def rows(self, poses: FloatArray, drives: FloatArray) -> Rows:
        """Return the legs at poses (N, 7) and drives (N, n)."""
        equations = self._equations(drives)
        ends, normals = (np.stack(part, axis=1) for part in list(zip(*equations, strict=True))[::2])
        points = np.array([self.legs[i].point for i in self.owners])
        places = poses[:, None, :3] + np.einsum("nij,mj->nmi", se3.matrices(poses), points)
        spans = places - ends
        with np.errstate(invalid="ignore", divide="ignore"):
            along = spans / np.linalg.norm(spans, axis=-1, keepdims=True)
        held = np.any(normals != 0.0, axis=-1, keepdims=True)
        return Rows(np.where(held, normals, along), places, spans)

    def jacobians(self, poses: FloatArray, drives: FloatArray) -> Jacobians:
        """Return the derivatives of the residuals by displacements (omega; shift of the platform's origin) in base axes, and by the
        drives."""
        rows, by_drives, _ = self._changes(poses, drives)
        d, arm = rows.directions, rows.places - poses[:, None, :3]
        return Jacobians(np.concatenate([np.cross(arm, d), d], axis=-1), -by_drives)

    def closing(self, poses: FloatArray, drives: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals (N, 6) [mm] at poses (N, 7) and drives (N, n), and their derivatives (N, 6, p) by the parameters."""
        return self.residuals(poses, drives), -self._changes(poses, drives)[2]

    def derivatives(
        self, joints: FloatArray, side: FloatArray | None = None, of: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        joints = np.asarray(joints, dtype=np.float64)
        poses = self.forward(joints)
        known = ~np.isnan(poses[:, 0])
        by_joints = np.full((len(poses), len(self.joint_names), EQUATIONS), np.nan)
        every = np.full((len(poses), len(self.parameters), EQUATIONS), np.nan)
        if known.any():
            rows, by_drives, by_values = self._changes(poses[known], joints[known])
            back = np.linalg.pinv(rows.pluecker)
            by_joints[known] = np.swapaxes(back @ by_drives, 1, 2)
            every[known] = np.swapaxes(back @ by_values, 1, 2)
        return poses, by_joints, every if of is None else every[:, of]

    def inverse(self, pose: FloatArray, seed: int = 0) -> FloatArray:
        roots = [r[0] for r in self.roots(np.asarray(pose)[None])]
        every = np.array([np.concatenate(one) for one in product(*roots)]).reshape(-1, len(self.joint_names))
        every = every[np.isfinite(every).all(axis=1)]
        low, high = self.limits
        every = nearest_turns(every, 0.5 * (low + high), self.sliding)
        every = every[((every >= low) & (every <= high)).all(axis=1)]
        if not len(every):
            return every
        reached = self.forward(every)
        there = ~np.isnan(reached[:, 0])
        every, reached = every[there], reached[there]
        off = np.abs(se3.displacement(reached, pose) / self.units).max(axis=1)
        return np.asarray(every[off < REACHED_MM])

    def roots(self, poses: FloatArray) -> list[FloatArray]:
        """Return, for each leg, (N, roots, d) drives that take its upper end to poses (N, 7); limits of legs without drives are not
        checked."""
        turn = se3.matrices(poses)
        return [leg.of.roots(leg.values, poses[:, :3] + turn @ leg.point, leg.carried) for leg in self.legs]

    def nearest(self, poses: FloatArray) -> FloatArray:
        """(N, 7) poses that the platform can take, with the components of poses (N, 7) that are `commanded`; NaN where there is none near
        home. A robot of six joints can take all."""
        if len(self.joint_names) == EQUATIONS:
            return np.asarray(poses)
        idle = np.flatnonzero([not self.legs[i].of.drives for i in self.owners])
        determined = [COMPONENTS.index(c) for c in self.commanded]
        still, at = np.tile(self.home_joints, (len(poses), 1)), np.tile(self.home, (len(poses), 1))
        chosen = np.tile(np.eye(EQUATIONS), (len(at), 1, 1))
        way = self._components(poses, at)[:, determined] / self.units[determined]
        parts = min(1 + int(np.ceil(np.abs(way).max(initial=0.0) / self.stride_mm)), MOST_PARTS)
        for k in range(parts + 8):
            # steadily there from home, so that no other assembly is taken for it
            left = 1.0 / max(parts - k, 1)
            lacks = np.concatenate([-self.residuals(at, still)[:, idle], left * self._components(poses, at)[:, determined]], axis=1)
            chosen[:, :3, :3] = np.swapaxes(se3.matrices(at), 1, 2)
            rows = np.concatenate([self.jacobians(at, still).output[:, idle], chosen[:, determined]], axis=1)
            step = (np.linalg.pinv(rows * self.units) @ lacks[..., None])[..., 0]
            step /= np.maximum(1.0, np.abs(step).max(axis=1) / (2.0 * STRIDE * self.size_mm))[:, None]
            at = se3.displaced(at, step * self.units)
        off = np.concatenate([self.residuals(at, still)[:, idle], (self._components(poses, at) / self.units)[:, determined]], axis=1)
        return np.where((np.abs(off).max(axis=1) < REACHED_MM)[:, None], at, np.nan)

    def _components(self, poses: FloatArray, reference: FloatArray) -> FloatArray:
        """(N, 6) displacement from reference to poses, its turn about the platform's axes."""
        delta = se3.displacement(poses, reference)
        delta[:, :3] = np.einsum("nji,nj->ni", se3.matrices(reference), delta[:, :3])
        return delta

    def follow(self, poses: FloatArray, start: FloatArray) -> FloatArray:
        """(N, n) joint values along poses (N, 7) of a path that begins near the joint values start (n,), each leg at the root that it
        begins with; RobotError names the first sample that cannot be reached, or where a joint's limit is passed or a joint jumps."""
        attained = self.nearest(poses)
        lost = np.asarray(np.isnan(attained).any(axis=1))
        roots = self.roots(np.where(lost[:, None], self.home, attained))
        columns: list[FloatArray] = []
        for every, near in zip(roots, np.split(start, self._cuts), strict=True):
            slides = self.sliding[sum(c.shape[1] for c in columns) :][: len(near)]
            away = nearest_turns(every[0], near, slides) - near
            own = every[:, int(np.argmin(np.nan_to_num(np.abs(away), nan=np.inf).max(axis=1, initial=0.0)))].copy()
            turning = np.flatnonzero(~slides)
            steps = np.diff(own[:, turning], axis=0, prepend=near[turning][None])
            own[:, turning] = near[turning] + np.cumsum(steps - 2.0 * np.pi * np.round(np.nan_to_num(steps) / (2.0 * np.pi)), axis=0)
            columns.append(own)
        joints = np.concatenate(columns, axis=1)
        self._say(lost | np.isnan(joints).any(axis=1), "robots.platform_cannot_be", poses)
        low, high = self.limits
        beyond = (joints < low - 1e-9) | (joints > high + 1e-9)
        if beyond.any():
            sample = int(np.argmax(beyond.any(axis=1)))
            j = int(np.argmax(beyond[sample]))
            value, unit = joint_value(self, j, joints[sample, j])
            raise RobotError(
                message("error.sample_would_be_at_beyond", sample=sample, joint_names=self.joint_names[j], value=value, unit=unit), sample
            )
        jumps = np.abs(np.diff(joints, axis=0)) > np.where(self.sliding, self.size_mm, MOST_RAD)
        self._say(np.concatenate([[False], jumps.any(axis=1)]), "robots.joint_jumps", poses)
        return joints

    def _say(self, bad: BoolArray, code: str, poses: FloatArray) -> None:
        if bad.any():
            sample = int(np.argmax(bad))
            where = numbers("en", poses[sample], ".6g")
            raise RobotError(message(code, sample=sample, where=where), sample)

    @cached_property
    def _cuts(self) -> IntArray:
        return np.cumsum([len(leg.of.drives) for leg in self.legs])[:-1]

    def _equations(self, drives: FloatArray) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """End (N, 3), length (N,) and normal (N, 3) of each, zeros where it is a distance."""
        out = []
        for leg, own in zip(self.legs, np.split(drives, self._cuts, axis=1), strict=True):
            for e in leg.equations(own):
                normal = np.zeros_like(e.end) if e.normal is None else e.normal
                out.append((np.real(e.end), np.real(e.length), np.real(normal)))
        return out

    def _held(self, drives: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return points (6, 3) on the platform, and their constraints at drives (N, n): ends (N, 6, 3), lengths (N, 6), normals (N, 6,
        3)."""
        ends, lengths, normals = (np.stack(part, axis=1) for part in zip(*self._equations(drives), strict=True))
        return np.array([self.legs[i].point for i in self.owners]), ends, lengths, normals

    def _changes(self, poses: FloatArray, drives: FloatArray) -> tuple[Rows, FloatArray, FloatArray]:
        """Rows, and right sides (N, 6, n) by the drives and (N, 6, p) by the parameters."""
        rows = self.rows(poses, drives)
        count = len(poses)
        of_platform = -np.einsum("nic,ncj->nij", rows.directions, se3.matrices(poses))
        by_drives = np.zeros((count, EQUATIONS, len(self.joint_names)))
        by_values = np.zeros((count, EQUATIONS, len(self.parameters)))
        equation = joint = parameter = 0
        for number, (leg, own) in enumerate(zip(self.legs, np.split(drives, self._cuts, axis=1), strict=True)):
            many = int((self.owners == number).sum())
            at = range(equation, equation + many)
            by_values[:, at, parameter : parameter + 3] = of_platform[:, at]
            changes = leg.derivatives(own)
            for k in range(0, len(changes), many):
                for i, (change, by_drive) in zip(at, changes[k : k + many], strict=True):
                    right = np.einsum("nc,nc->n", rows.directions[:, i], change.end) + change.length
                    if change.normal is not None:
                        right = right - np.einsum("nc,nc->n", change.normal, rows.spans[:, i])
                    if by_drive:
                        by_drives[:, i, joint + k // many] = right
                    else:
                        by_values[:, i, parameter + 3 + k // many - len(leg.of.drives)] = right
            equation, joint, parameter = equation + many, joint + len(leg.of.drives), parameter + len(leg.parameters)
        return rows, by_drives, by_values


U_MM = 0.1
"""Standard uncertainty of an equation by the measured pose, as the scale for a value's own."""
ROUNDS = 12
SETTLED = 1e-6
HELD = 1e-12


def legs_at(robot: Parallel, poses: FloatArray, joints: FloatArray, free: IntArray) -> FloatArray:
    """(p,) changes of the parameters, rad and mm, that fit each leg best to poses (N, 7) of the flange in the base at joint values (N, n);
    those of the indices free alone change."""
    parameters = robot.parameters
    width = np.full(len(parameters), HELD)
    width[free] = [parameters[i].width * parameters[i].size for i in free]
    change = np.zeros(len(parameters))
    cuts = np.cumsum([0, *(len(leg.parameters) for leg in robot.legs)])
    for _ in range(ROUNDS):
        own = robot.moved(change)
        lacks, by_values = own.closing(poses, joints)
        step = np.zeros_like(change)
        for leg in range(len(robot.legs)):
            part, equations = slice(cuts[leg], cuts[leg + 1]), robot.owners == leg
            rows = by_values[:, equations, part].reshape(-1, cuts[leg + 1] - cuts[leg]) / U_MM * width[part]
            right = -lacks[:, equations].reshape(-1) / U_MM
            square = rows.T @ rows + np.eye(rows.shape[1])
            step[part] = width[part] * np.linalg.solve(square, rows.T @ right - change[part] / width[part])
        change = change + step
        if np.abs(step / width).max() < SETTLED:
            break
    return change
