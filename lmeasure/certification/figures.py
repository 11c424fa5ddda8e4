"""Figures: what is certified of which part of the program, as functions of the parts' states; and those of clause 7 and 10."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure import conventions, se3
from lmeasure.arrays import FloatArray, IntArray
from lmeasure.certification import iso9283_pose as iso
from lmeasure.certification.attained import AttainedPose
from lmeasure.certification.errors_of_poses import PoseErrors
from lmeasure.certification.uncertainty import reduction, reduction_of_mean
from lmeasure.program import Program

Function = Callable[[Mapping[str, Any]], FloatArray]

SINGULAR_DEG_PER_DEG = 10.0
"""A turn of a degree that moves an angle by more than as many degrees: the angles are near a singular orientation and tell nothing."""


@dataclass(frozen=True)
class Figure:
    """A characteristic yet without its value: function of the parts named in needs; vector: the figure whose verdict a component takes."""

    name: str
    clause: str
    unit: str
    cycles: int
    of: Function
    needs: tuple[str, ...]
    pose: str | None = None
    path: str | None = None
    part: str | None = None
    vector: str | None = None
    angles: str | None = None
    extension: bool = False

    @property
    def signed(self) -> bool:
        """Whether it may be negative, and zero without being bad."""
        return self.vector is not None or self.name in SIGNED


SIGNED = ("AD_p", "AV", "WS", "WF")


@dataclass(frozen=True)
class Cycles:
    """Attained poses: position (..., n, 3) [mm], angles (..., n, 3) [deg] and rotation vector (..., n, 3) [deg, base axes], both counted
    from the commanded orientation; None where the orientation is not measured or the angles are singular."""

    position: FloatArray
    angles_deg: FloatArray | None
    turn_deg: FloatArray | None


def angles_deg(name: str, rotation: Rotation) -> FloatArray:
    """Angles of a convention, always in degrees."""
    values = conventions.angles_from_rotation(name, rotation)
    return np.degrees(values) if conventions.convention(name).columns[0].endswith("_rad") else values


def angle_rates(name: str, rotation: Rotation) -> FloatArray:
    """(n, 3, 3) derivatives of a convention's angles [deg] by a small rotation [rad] in base axes, at n rotations."""
    step = 1e-6
    columns = []
    for axis in np.eye(3):
        there, back = (angles_deg(name, Rotation.from_rotvec(sign * step * axis) * rotation) for sign in (1.0, -1.0))
        columns.append(iso.wrapped(there - back) / (2.0 * step))
    return np.stack(columns, axis=-1)


def singular(name: str, rotation: Rotation) -> bool:
    """Whether the angles tell nothing at one of the rotations."""
    rates = np.radians(angle_rates(name, rotation))
    return bool(np.linalg.norm(rates, axis=(-2, -1)).max() > SINGULAR_DEG_PER_DEG)


@dataclass(frozen=True)
class PosePart:
    """The cycles of a pose with the law of their errors; convention of the angles or None; groups (n,): numbers
    of the groups of cycles at one place; see `uncertainty.Part`."""

    attained: AttainedPose
    errors: PoseErrors
    convention: str | None
    groups: IntArray
    _states: dict[bool, Cycles] = field(init=False, default_factory=dict)
    _rates: list[FloatArray] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        a, e = self.attained, self.errors
        common, random = e.factors.mean(axis=0), e.random.mean(axis=0)
        laws = [random, random / len(a.poses) + common @ common.T]
        for group in range(int(self.groups.max()) + 1):
            members = self.groups == group
            # what other groups have in common with it does not set them apart
            alone = np.isin(e.place, e.place[~members], invert=True)[:, None, None]
            local = replace(e, local=np.where(alone, e.local, 0.0), shared=e.shared[:, :, :0])[members].factors.mean(axis=0)
            laws.append(random / np.sum(members) + local @ local.T)
        turn, angles = self._orientation()
        position = a.poses[:, :3]
        self._states[False] = Cycles(position, angles, turn)
        likely = a.commanded[:3] + _reduced(position - a.commanded[:3], [law[3:, 3:] for law in laws], self.groups)
        likely_turn = None if turn is None else _reduced(turn, [np.degrees(np.degrees(law[:3, :3])) for law in laws], self.groups)
        likely_angles = None
        if angles is not None and self.convention is not None:
            mean = se3.rotation(a.poses).mean()
            rates = angle_rates(self.convention, Rotation.from_quat(mean.as_quat()[None, :]))[0]
            self._rates.append(rates)
            # the standard takes angles one by one, and so do what errors add to them
            of_angles = [rates @ law[:3, :3] @ rates.T for law in laws]
            axes = [slice(i, i + 1) for i in range(3)]
            likely_angles = np.hstack([_reduced(angles[:, i], [law[i, i] for law in of_angles], self.groups) for i in axes])
        self._states[True] = Cycles(likely, likely_angles, likely_turn)

    def _orientation(self) -> tuple[FloatArray | None, FloatArray | None]:
        """Rotation vectors and angles (n, 3) [deg] from the commanded orientation."""
        if np.isnan(self.attained.poses[0, 3]):
            return None, None
        rotation, commanded = se3.rotation(self.attained.poses), se3.rotation(self.attained.commanded)
        turn = np.degrees((rotation * commanded.inv()).as_rotvec())
        if self.convention is None:
            return turn, None
        return turn, iso.wrapped(angles_deg(self.convention, rotation) - angles_deg(self.convention, commanded))

    def state(self, errors: FloatArray, reduced: bool) -> Cycles:
        """See `uncertainty.Part`."""
        state, turned = self._states[reduced], errors[..., :3]
        return Cycles(
            state.position + errors[..., 3:],
            None if state.angles_deg is None else state.angles_deg + turned @ self._rates[0].T,
            None if state.turn_deg is None else state.turn_deg + np.degrees(turned),
        )


def _reduced(values: FloatArray, laws: Sequence[FloatArray], groups: IntArray) -> FloatArray:
    """Deviations (n, d) from the commanded with their mean, the means of their groups about it and the scatter within groups reduced by
    what errors have added. laws: covariances (d, d) of the errors of one, of the mean, and of the mean of each group."""
    axes, mean = values.shape[1], values.mean(axis=0)
    out = np.tile(reduction_of_mean((mean**2).sum(), np.trace(laws[1]), axes) * mean, (len(values), 1))
    away = np.empty_like(values)
    several = len(laws) > 3
    for group, law in enumerate(laws[2:]):
        members = groups == group
        apart = values[members].mean(axis=0) - mean
        away[members] = values[members] - mean - apart
        if several:
            out[members] += reduction_of_mean((apart**2).sum(), np.trace(law), axes) * apart
    freedom = max(len(values) - len(laws) + 2, 1)
    square, added = (away**2).sum() / freedom, np.trace(laws[0])
    spread = np.trace(laws[0] @ laws[0])
    # axes that err alike count as so many
    alike = added**2 / spread if spread > 0.0 else 1.0
    less = reduction(square, added, freedom * alike)
    if several and np.bincount(groups).min() > 1 and square > 0.0:
        return np.asarray(out + _alike(away, groups, laws[0], square, float(less)))
    return np.asarray(out + less * away)


def _alike(away: FloatArray, groups: IntArray, law: FloatArray, square: float, less: float) -> FloatArray:
    """Scatter (n, d) within groups with its size reduced to `less` of it, and what the groups' repeatabilities differ by to the least that
    could have been measured so large.

    Of k degrees of freedom the mean square S + E, E of the errors, is known to 2 tr E^2 + 4 tr(E S) over k, the repeatability to half as
    much of itself.
    """
    sizes = np.bincount(groups)
    of_robot = max(square - float(np.trace(law)), 0.0)
    relative = (2.0 * np.trace(law @ law) + 4.0 * np.trace(law) * of_robot / len(law)) / (4.0 * square**2 * (sizes - 1))
    repeatability = np.array([iso.pose_repeatability(away[groups == g]) for g in range(len(sizes))])
    middle = repeatability.mean()
    apart = repeatability - middle
    wanted = less * middle + reduction_of_mean((apart**2).sum(), middle**2 * relative.sum(), len(sizes) - 1) * apart
    factor = np.divide(np.maximum(wanted, 0.0), repeatability, out=np.zeros_like(wanted), where=repeatability > 0.0)
    return np.asarray(factor[groups, None] * away)


def component(of: Function, i: int | tuple[int, int]) -> Function:
    """One component of a figure that has several."""
    return lambda states: of(states)[..., i] if isinstance(i, int) else of(states)[..., i[0], i[1]]


def components(names: Sequence[str], of: Function, **common: Any) -> list[Figure]:
    """Figures of the components of (..., 3)."""
    return [Figure(name, of=component(of, i), **common) for i, name in enumerate(names)]


ANGLES = ("a", "b", "c")
AXES = ("x", "y", "z")


def pose_figures(key: str, part: PosePart) -> list[Figure]:
    """Clause 7.2 of one pose: AP always, RP from two cycles on."""
    n, commanded = len(part.attained.poses), part.attained.commanded[:3]
    common: dict[str, Any] = {"cycles": n, "needs": (key,), "pose": part.attained.name}
    out = [Figure("AP_p", "7.2.1", "mm", of=lambda s: iso.pose_accuracy(s[key].position, commanded), **common)]
    out += components(
        [f"AP_{a}" for a in AXES],
        lambda s: iso.pose_accuracy_components(s[key].position, commanded),
        clause="7.2.1",
        unit="mm",
        vector="AP_p",
        **common,
    )
    state = part.state(np.zeros((n, 6)), reduced=False)
    if state.turn_deg is not None:
        rot = {"unit": "deg", "extension": True, **common}
        out.append(Figure("AP_rot", "7.2.1", of=lambda s: iso.rotation_accuracy(s[key].turn_deg), **rot))
    zero = np.zeros(3)
    angular: dict[str, Any] = {"unit": "deg", "angles": part.convention, **common}
    if state.angles_deg is not None:
        names = [f"AP_{a}" for a in ANGLES]
        out += components(names, lambda s: iso.orientation_accuracy(s[key].angles_deg, zero), clause="7.2.1", vector="AP_rot", **angular)
    if n < 2:
        return out
    out.append(Figure("RP_l", "7.2.2", "mm", of=lambda s: iso.pose_repeatability(s[key].position), **common))
    if state.angles_deg is not None:
        names = [f"RP_{a}" for a in ANGLES]
        out += components(names, lambda s: iso.orientation_repeatability(s[key].angles_deg, zero), clause="7.2.2", **angular)
    if state.turn_deg is not None:
        out.append(Figure("RP_rot", "7.2.2", of=lambda s: iso.rotation_repeatability(s[key].turn_deg), **rot))
    return out


def split(values: FloatArray, labels: Sequence[str]) -> list[FloatArray]:
    """Cycles (..., n, 3) by label, labels in order of their first use."""
    of = np.array(labels)
    return [values[..., of == label, :] for label in dict.fromkeys(labels)]


def numbered(labels: Sequence[Hashable]) -> IntArray:
    """(n,) numbers of labels, in order of their first use."""
    number = {label: i for i, label in enumerate(dict.fromkeys(labels))}
    return np.array([number[label] for label in labels], dtype=np.int64)


def groups_of(name: str, cycles: int, program: Program) -> IntArray:
    """(n,) numbers of the groups into which the program divides a pose's cycles: approach, robot and time."""
    pose = next(p for p in program.pose if p.name == name)
    sizes = [d.group for d in program.drift if d.pose == name]
    columns = [pose.approaches or [""] * cycles, pose.units or [""] * cycles, *([j // size for j in range(cycles)] for size in sizes)]
    return numbered(list(zip(*columns, strict=True)))


def group_figures(key: str, part: PosePart, program: Program) -> list[Figure]:
    """Clauses 7.2.3, 7.6 and 7.7: of the groups into which the program divides a pose's cycles."""
    pose = next(p for p in program.pose if p.name == part.attained.name)
    n, commanded = len(part.attained.poses), part.attained.commanded[:3]
    common: dict[str, Any] = {"cycles": n, "needs": (key,), "pose": pose.name}
    angular: dict[str, Any] = {"unit": "deg", "angles": part.convention, **common}
    has_angles = part.state(np.zeros((n, 6)), reduced=False).angles_deg is not None
    out: list[Figure] = []
    if len(set(pose.approaches)) > 1:
        labels = pose.approaches
        vap: dict[str, Any] = {"clause": "7.2.3"}
        out.append(Figure("vAP_p", unit="mm", of=lambda s: iso.multidirectional_variation(split(s[key].position, labels)), **vap, **common))
        if has_angles:
            names = [f"vAP_{a}" for a in ANGLES]
            out += components(names, lambda s: iso.multidirectional_variation_of_angles(split(s[key].angles_deg, labels)), **vap, **angular)
    if len(set(pose.units)) > 1:
        units = pose.units
        out.append(Figure("E", "7.7", "mm", of=lambda s: iso.exchangeability(split(s[key].position, units)), **common))
    for drift in program.drift:
        if drift.pose != pose.name or n < 2 * drift.group:
            continue
        times = [str(j // drift.group) for j in range(n - n % drift.group)]

        def grouped(values: FloatArray, times: list[str] = times) -> list[FloatArray]:
            return split(values[..., : len(times), :], times)

        common = {**common, "cycles": len(times)}
        angular = {**angular, "cycles": len(times)}
        out.append(Figure("dAP_p", "7.6", "mm", of=lambda s: iso.drift_of_accuracy(grouped(s[key].position), commanded), **common))
        if has_angles:
            names = [f"dAP_{a}" for a in ANGLES]
            out += components(names, lambda s: iso.drift_of_orientation(grouped(s[key].angles_deg)), clause="7.6", **angular)
        out.append(Figure("dRP_l", "7.6", "mm", of=lambda s: iso.drift_of_repeatability(grouped(s[key].position)), **common))
    return out


def distance_figures(one: str, other: str, parts: Mapping[str, PosePart], name: str) -> list[Figure]:
    """Clause 7.3: of two poses with the same number of cycles."""
    a, b = parts[one].attained, parts[other].attained
    commanded = a.commanded[:3] - b.commanded[:3]
    length = float(np.linalg.norm(commanded))
    common: dict[str, Any] = {"cycles": len(a.poses), "needs": (one, other), "pose": name}

    def accuracy(s: Mapping[str, Any]) -> FloatArray:
        return iso.distance_accuracy(s[one].position, s[other].position, length)

    out = [Figure("AD_p", "7.3.2", "mm", of=accuracy, **common)]
    out += components(
        [f"AD_{x}" for x in AXES],
        lambda s: iso.distance_accuracy_components(s[one].position, s[other].position, commanded),
        clause="7.3.2",
        unit="mm",
        vector="AD_p",
        **common,
    )
    if len(a.poses) < 2:
        return out
    out.append(Figure("RD", "7.3.3", "mm", of=lambda s: iso.distance_repeatability(s[one].position, s[other].position), **common))
    out += components(
        [f"RD_{x}" for x in AXES],
        lambda s: iso.distance_repeatability_components(s[one].position, s[other].position),
        clause="7.3.3",
        unit="mm",
        **common,
    )
    return out


def compliance_figures(key: str, part: PosePart, forces: FloatArray) -> list[Figure]:
    """Clause 10: of the axes along which a force acted."""
    common: dict[str, Any] = {"cycles": len(forces), "needs": (key,), "pose": part.attained.name}
    acted = np.abs(forces - forces.mean(axis=0)).max(axis=0) > 0
    return [
        Figure(f"C_{AXES[i]}", "10", "mm/N", of=component(lambda s: iso.static_compliance(s[key].position, forces), (i, i)), **common)
        for i in range(3)
        if acted[i]
    ]
