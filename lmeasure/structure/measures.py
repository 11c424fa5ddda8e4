"""Quality of a platform's support by links at a pose, and along a straight path: the determinant, and numbers that a user can judge.

A determinant has the unit mm^3, without a scale for small or large. The others are the condition, the motion of the platform's rim by
length errors of 1 mm together, and the radius that holds 95 % of its origin's errors from independent errors of the lengths.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from lmeasure import linkages
from lmeasure.core import FileFormatError, FloatArray, StructureError, se3
from lmeasure.kernels import COUNT_LENGTH, RADIUS, radius_95, wrap_geometry
from lmeasure.structure.assemblies import apart_mm, found_of, lengths_at, rows_at
from lmeasure.structure.links import Linkage
from lmeasure.text import message

ALONG = 201  # poses of a way
REACHED_MM = 1e-6  # tolerance of the lengths of a reached pose
NEAR_MM = 1.0  # a pose no farther from an assembly is that assembly


def lines_of(linkage: Linkage) -> linkages.Lines:
    """The lines of the links at poses: of cables over pulleys their free spans, from where they leave the pulley."""
    rows = linkage.wrapped
    if linkage.rods is not None:
        return linkage.rods.lines
    if rows is None:
        return lambda poses: linkages.link_rows(linkage.base, linkage.platform, poses)
    rows = np.ascontiguousarray(rows)

    def free(poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        flat = np.ascontiguousarray(poses.reshape(-1, 7))
        _, tangent, attachment, angle = wrap_geometry(rows, flat)
        along = attachment - tangent
        straight = np.linalg.norm(along, axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            e = along / straight[..., None]
        shape, m = poses.shape[:-1], len(rows)
        lengths = straight + angle * rows[:, RADIUS]
        M = np.concatenate([e, np.cross(tangent, e)], axis=-1)
        return M.reshape(*shape, m, 6), lengths.reshape(*shape, m), attachment.reshape(*shape, m, 3)

    return free


@dataclass(frozen=True)
class PoseMeasures:
    """At poses (n,): determinant [mm^3], NaN with more than six links; rank; condition and mm_per_mm, infinite if the links do not fix the
    platform; u95_mm: of its origin, for the given uncertainties of lengths; worst_angle_deg: pressure angle."""

    determinant: FloatArray
    rank: FloatArray
    condition: FloatArray
    mm_per_mm: FloatArray
    u95_mm: FloatArray
    worst_angle_deg: FloatArray


def held(linkage: Linkage, poses: FloatArray, u_mm: FloatArray | float = 1.0) -> PoseMeasures:
    """Return how the links hold the platform at poses (n, 7); u_mm: standard uncertainty of each length."""
    M, _, points = lines_of(linkage)(poses)
    known = np.asarray(np.isfinite(M).all(axis=(1, 2)))
    M = np.where(known[:, None, None], M, 0.0)
    e, rim, m = M[..., :3], linkages.rim_mm(linkage.platform), len(linkage.base)
    middle = se3.apply(poses, np.tile(linkage.platform.mean(axis=0), (len(poses), 1)))
    about_middle = np.concatenate([(M[..., 3:] - np.cross(middle[:, None], e)) / rim, e], axis=-1)
    s = np.linalg.svd(np.nan_to_num(about_middle), compute_uv=False)
    rank = np.asarray((s > linkages.LOST * np.maximum(s[:, :1], 1e-300)).sum(axis=1))
    sound = np.asarray(known & (rank == 6))
    with np.errstate(divide="ignore", invalid="ignore"):
        condition, gain = np.where(sound, s[:, 0] / s[:, 5], np.inf), np.where(sound, 1.0 / s[:, 5], np.inf)
    u95, worst = np.full(len(poses), np.inf), np.full(len(poses), 90.0)
    about_origin = np.concatenate([(M[..., 3:] - np.cross(poses[:, None, :3], e)) / rim, e], axis=-1)
    u = np.broadcast_to(np.asarray(u_mm, dtype=np.float64), m)
    for i in np.flatnonzero(sound):
        moved = (np.linalg.pinv(about_origin[i] / u[:, None]) if m > linkages.LINKS else np.linalg.inv(about_origin[i]) * u)[3:]
        C = moved @ moved.T
        u95[i] = radius_95(C[0, 0], C[1, 1], C[2, 2], C[0, 1], C[0, 2], C[1, 2])
        worst[i] = np.degrees(linkages.line_pressure_angles(M[i], points[i], middle[i], rim).max())
    det = np.where(known, np.linalg.det(M), np.nan) if m == linkages.LINKS else np.full(len(poses), np.nan)
    return PoseMeasures(det, np.where(known, rank, 0), condition, gain, u95, worst)


def at_pose(linkage: Linkage, pose: FloatArray) -> dict[str, Any]:
    """Return the result of `lmeasure structure` for a pose (7,): links straight from point to point, and the real cables."""
    straight = replace(linkage, cables=None)
    M, own, points = lines_of(straight)(pose)
    if not (own > 0.0).all() or not np.isfinite(M).all():
        raise FileFormatError(message("error.position_mm_a_link"))
    if linkage.rods is not None and not (linkage.rods.margins(pose) > 0.0).all():
        rod = int(np.argmin(linkage.rods.margins(pose)))
        raise FileFormatError(message("error.position_mm_rod_on_the_wrong_side", number=rod + 1, mm=-linkage.rods.margins(pose)[rod]))
    one = held(straight, pose[None])
    record: dict[str, Any] = _figures(one) | {"least_seen_screw": _least_seen(straight, pose)}
    record |= {"lengths_mm": own.tolist(), "rows": rows_at(straight, pose[None])[1][0].tolist()}
    if len(linkage.base) > linkages.LINKS:
        record["gradient"] = None
    elif linkage.rods is not None:
        record["gradient"] = linkage.rods.gradient(pose).tolist()
    else:
        record["gradient"] = linkages.gradients(linkage.base, linkage.platform, pose).tolist()
    middle = se3.apply(pose, linkage.platform.mean(axis=0))
    held_by = one.rank[0] == 6 or len(M) == linkages.LINKS
    angles = (
        linkages.line_pressure_angles(M, points, middle, linkages.rim_mm(linkage.platform)) if held_by else np.full(len(M), np.pi / 2.0)
    )
    record["pressure_angles_deg"] = np.degrees(angles).tolist()
    if linkage.hooke is not None:
        along = se3.apply(pose, linkage.platform) - linkage.base
        turns = linkage.hooke.turns(along / np.linalg.norm(along, axis=1, keepdims=True), se3.matrices(pose[None])[0])
        record["leg_turns_deg"] = {linkage.names[i][0]: float(np.degrees(t)) for i, t in zip(linkage.hooke.legs, turns, strict=True)}
    if linkage.wrapped is not None:
        lengths = lengths_at(linkage, pose[None])[0]
        if not np.isfinite(lengths).all():
            name = linkage.names[int(np.argmin(np.isfinite(lengths)))][0]
            raise FileFormatError(message("error.position_mm_cable_cannot", name=name))
        as_they_run = held(linkage, pose[None])
        # a change of length has two counts, there and at the zero pose, each with an error of up to half a count
        counts = held(linkage, pose[None], linkage.wrapped[:, COUNT_LENGTH] / np.sqrt(6.0))
        record["wrapped"] = _figures(as_they_run) | {
            "lengths_mm": lengths.tolist(),
            "worst_pressure_angle_deg": float(as_they_run.worst_angle_deg[0]),
            "u95_position_mm": _number(counts.u95_mm[0]),
        }
    return record


def at_singular(linkage: Linkage, pose: FloatArray) -> dict[str, Any]:
    """Return the result of `lmeasure structure --singular` for the singular pose nearest to a pose (7,): straight links, six of them.
    StructureError without one near it, or with more than six links."""
    base, platform, rods = linkage.base, linkage.platform, linkage.rods
    if len(base) != linkages.LINKS:
        raise StructureError(message("error.singular_has_links_singular", n_base=len(base)))
    if not linkage.straight:
        raise StructureError(message("error.singular_takes_no_such_rods"))
    at = linkages.nearest_singular(base, platform, pose)
    rates = None
    if rods is not None:
        if not (rods.margins(at) > 0.0).all():
            raise StructureError(message("error.singular_no_singular_pose"))
        rates = rods.rates_of_drives(rods.placed(at).lengths)
    around, signs = linkages.neighbourhood(base, platform, at), linkages.leading_out(base, platform, at, rates)
    leaves = len(around.twists) < linkages.LINKS
    exit_twist = around.gradient / np.linalg.norm(around.gradient) if leaves else None
    # chains with rods have other passive pairs
    sets = [] if rods is not None else linkages.extra_drives(base, platform, at, exit_twist=exit_twist)
    names = [name for name, _, _ in linkage.names]
    words = {1: "lengthen", -1: "shorten", 0: "no part"}

    def drive(d: linkages.Drive) -> dict[str, Any]:
        return {
            "link": names[d.link],
            "pair": "platform" if d.pair == "body" else d.pair,
            "axis": d.axis.tolist(),
            "rates": d.rates.tolist(),
            "exit_rate": _number(d.exit_rate),
            "wrench": d.wrench.tolist(),
        }

    lost = linkages.lost_twists(base, platform, at)
    return {
        "position_mm": at[:3].tolist(),
        "quaternion_xyzw": at[3:].tolist(),
        "away_mm": float(apart_mm(at[None], pose, linkages.rim_mm(platform))[0]),
        "rank": linkages.LINKS - len(lost),
        "lost_twists": lost.tolist(),
        "gradient": around.gradient.tolist(),
        "topology": around.topology,
        "twists": around.twists.tolist(),
        "leads_out": None if signs is None else {name: words[int(sign)] for name, sign in zip(names, signs, strict=True)},
        "extra_drives": None
        if rods is not None
        else [
            {"drives": [drive(d) for d in one.drives], "instead_of": [names[i] for i in one.spared], "determinant": one.determinant}
            for one in sets
        ],
    }


def _least_seen(linkage: Linkage, pose: FloatArray) -> dict[str, Any]:
    """The screw of the platform that lengths see least: axis, pitch per turn (None of a shift), change of length per mm of the rim."""
    rows, m = rows_at(linkage, pose[None])[1][0], len(linkage.base)
    screw = linkages.Split(rows, pose[:3], np.arange(6), np.ones(m), size_mm=linkages.rim_mm(linkage.platform)).lost
    pitch = float(screw.pitch_mm) if np.isfinite(screw.pitch_mm) else None
    return {"direction": screw.direction.tolist(), "point_mm": screw.point.tolist(), "pitch_mm": pitch, "mm_per_mm": screw.mm_per_mm}


def _figures(one: PoseMeasures) -> dict[str, Any]:
    return {
        "determinant": _number(one.determinant[0]),
        "rank": int(one.rank[0]),
        "condition": _number(one.condition[0]),
        "mm_per_mm": _number(one.mm_per_mm[0]),
        "u95_mm_per_mm": _number(one.u95_mm[0]),
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def forward(linkage: Linkage, pose: FloatArray, lengths: FloatArray) -> dict[str, Any] | None:
    """Return the pose of lengths (m,) that is reached from a pose (7,) by driving them steadily, by the screw method (thesis 4.4); None
    where a singular pose or the end of a rod is met on the way."""

    def rows(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        own, here = rows_at(linkage, poses)[::-1]
        return np.concatenate([own[..., :3] + np.cross(poses[:, None, :3], own[..., 3:]), own[..., 3:]], axis=-1), here

    poses, good = linkages.driven(rows, pose[None], lengths[None], linkages.rim_mm(linkage.platform))
    here = rows(np.concatenate([pose[None], poses]))
    off = float(np.abs(here[1][1] - lengths).max())
    same = len(lengths) > linkages.LINKS or np.linalg.det(here[0]).prod() > 0.0
    kept = linkage.rods is None or (linkage.rods.margins(poses[0]) > 0.0).all()
    if not (good[0] and same and kept and (off < REACHED_MM or len(lengths) > linkages.LINKS)):
        return None
    return {"position_mm": poses[0, :3].tolist(), "quaternion_xyzw": poses[0, 3:].tolist(), "misses_mm": off}


def others_near(linkage: Linkage, pose: FloatArray) -> dict[str, Any]:
    """The other assemblies of the lengths at a pose (7,): where they are and how far away, the nearest first [mm, a turn at the rim]."""
    lengths = lengths_at(linkage, pose[None])[0]
    found = found_of(linkage, lengths)
    away = apart_mm(found.poses, pose, linkages.rim_mm(linkage.platform))
    order = [i for i in np.argsort(away) if away[i] > NEAR_MM]
    each = [
        {"position_mm": found.poses[i, :3].tolist(), "quaternion_xyzw": found.poses[i, 3:].tolist(), "apart_mm": float(away[i])}
        for i in order
    ]
    return {"other_assemblies": each, "other_assemblies_status": found.status}


def along(linkage: Linkage, pose: FloatArray, to: FloatArray) -> dict[str, Any]:
    """Return the quality of support on the straight path from a pose (7,) to another, turned about one axis: columns of ALONG places."""
    step = se3.displacement(to[None], pose)[0]
    share = np.linspace(0.0, 1.0, ALONG)
    poses = se3.displaced(pose, share[:, None] * step)
    found = held(linkage, poses)
    sign = np.sign(found.determinant)
    crossings = np.flatnonzero(sign[1:] * sign[:-1] < 0.0)
    columns = {"determinant": found.determinant, "condition": found.condition, "mm_per_mm": found.mm_per_mm}
    columns |= {"u95_mm_per_mm": found.u95_mm, "worst_pressure_angle_deg": found.worst_angle_deg}
    return {
        "share": share.tolist(),
        "position_mm": poses[:, :3].tolist(),
        **{name: [_number(v) for v in values] for name, values in columns.items()},
        "singular_at_share": [
            float(share[i] + (share[1] - share[0]) * _zero(found.determinant[i], found.determinant[i + 1])) for i in crossings
        ],
    }


def _zero(before: float, after: float) -> float:
    return float(before / (before - after))


@dataclass(frozen=True)
class Parts:
    """The motion of n poses in two parts (thesis, conclusion): along the screw that lengths see least, `reciprocal`, and orthogonal to it,
    a turn counted at the platform's rim.

    reciprocal_mm, orthogonal_mm (n,): of the step from the pose before, 0 at the first; reciprocal_mm_per_mm, orthogonal_mm_per_mm (n,):
    the largest error of each part by lengths that are off by 1 mm together. twists (n, 6): the screw (omega; v of the platform's origin),
    of 1 mm.
    """

    reciprocal_mm: FloatArray
    orthogonal_mm: FloatArray
    reciprocal_mm_per_mm: FloatArray
    orthogonal_mm_per_mm: FloatArray
    twists: FloatArray

    def columns(self) -> dict[str, FloatArray]:
        """Columns of a table beside those of the poses; errors without a bound, at singular poses, are empty."""
        own = ("reciprocal_mm", "orthogonal_mm", "reciprocal_mm_per_mm", "orthogonal_mm_per_mm")
        screw = zip(("screw_rx_rad", "screw_ry_rad", "screw_rz_rad", "screw_x_mm", "screw_y_mm", "screw_z_mm"), self.twists.T, strict=True)
        return {name: np.where(np.isfinite(v := getattr(self, name)), v, np.nan) for name in own} | dict(screw)


def parts(linkage: Linkage, poses: FloatArray) -> Parts:
    """The parts of the motion along poses (n, 7); NaN at poses that are NaN and after them."""
    known = np.asarray(~np.isnan(poses).any(axis=1))
    unit = np.repeat([1.0 / linkages.rim_mm(linkage.platform), 1.0], 3)
    lost, s = np.full((len(poses), 6), np.nan), np.full((len(poses), 6), np.nan)
    rows = rows_at(linkage, poses[known])[1] * unit
    good = np.isfinite(rows).all(axis=(1, 2))
    at = np.flatnonzero(known)[good]
    s[at], lost[at] = (part if i == 0 else part[:, -1] for i, part in enumerate(np.linalg.svd(rows[good])[1:]))
    # one direction along the motion
    for before, i in pairwise(at):
        lost[i] *= 1.0 if lost[i] @ lost[before] >= 0.0 else -1.0
    step = np.full((len(poses), 6), np.nan)
    both = np.flatnonzero(known[1:] & known[:-1]) + 1
    step[both] = se3.displacement(poses[both], poses[both - 1]) / unit
    if known[:1].all():
        step[:1] = 0.0
    along = np.einsum("ni,ni->n", lost, step)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Parts(along, np.linalg.norm(step - along[:, None] * lost, axis=1), 1.0 / s[:, 5], 1.0 / s[:, 4], lost * unit)
