"""Detours of a commanded path that would leave the limits: the least deviation, with the ends kept (thesis Rashoyan 2021, 5.2).

The thesis continues from the last good pose along the part of each step that is normal to the determinant's gradient, turns and shifts
apart. The determinant stays the same, the deviation is not the least, and a limit of the determinant does not limit the pressure angle (its
own example has angles up to 89.8 degrees where det >= 0.015). Here every pose beyond a limit is put onto the nearest one that keeps it, in
the norm of a displacement with turns counted at the rim; between two poses the path is halved until it keeps the limits too.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import nnls

from lmeasure.core import FloatArray, StructureError, se3
from lmeasure.linkages.bounds import PathBounds
from lmeasure.linkages.singularity import rim_mm
from lmeasure.text import message

STEPS = 60
SETTLED = 1e-8  # of the rim: gradients are differences
INSIDE = 1e-9  # of the limits' scale: a pose on a limit keeps it
HALVINGS = 3
TRIES = 4
BETWEEN = 1e-7  # of the limits' scale: as little as a limit may be missed by between two poses
APART = 50.0  # times the way of the command between two poses, beyond which they are not neighbours any more


@dataclass(frozen=True)
class Detour:
    """A path that keeps its limits: poses (m, 7); parameter (m,): where on the commanded path, in numbers of its poses; deviation_mm and
    deviation_rad (m,) from the command there; norm_mm (m,) both, a turn counted at the rim of the body."""

    poses: FloatArray
    parameter: FloatArray
    deviation_mm: FloatArray
    deviation_rad: FloatArray
    norm_mm: FloatArray


def detour(bounds: PathBounds, poses: FloatArray, margin: float = 0.0, *, turns: bool = True) -> Detour:
    """Return the commanded poses (n, 7), and more between them where needed, led around the limits; margin: distance from the limits, in
    their units (`Bounds.values`); turns: whether the body may be turned, too, or is only shifted.

    StructureError if an end is beyond a limit, or no pose near another keeps them, or they are broken between two poses however near, or
    two neighbours would be led to different sides.
    """
    for k in (0, len(poses) - 1):
        if not (bounds.values(poses[k]) >= margin).all():
            worst = bounds.names[int(np.argmin(bounds.values(poses[k])))]
            raise StructureError(message("error.path_sample_an_end", k=k + 1, worst=worst))
    aim = margin
    for _ in range(TRIES):
        found = _halved(bounds, poses, margin, aim, turns)
        short, where = _short(bounds, found, margin)
        if short <= BETWEEN:
            break
        # the straight way between two poses on a limit that bends cuts it: those are put so much farther inside
        aim += 1.5 * short
    else:
        raise StructureError(message("error.path_between_samples_and", where=where + 1, where2=where + 2))
    rim = rim_mm(bounds.body)
    parameter, out = np.array([t for t, _ in found]), np.array([p for _, p in found])
    wanted = np.array([at(poses, t) for t in parameter])
    off = se3.displacement(out, wanted)
    shift, turn = np.linalg.norm(off[:, 3:], axis=1), np.linalg.norm(off[:, :3], axis=1)
    way, own = (_ways(p, rim) for p in (wanted, out))
    apart = np.flatnonzero(own > APART * np.maximum(way, 1e-3 * way.max()))
    if len(apart):
        between = {"parameter": int(parameter[apart[0]]) + 1, "ceil": int(np.ceil(parameter[apart[0] + 1])) + 1}
        raise StructureError(message("error.path_between_samples_and_the", **between))
    return Detour(out, parameter, shift, turn, np.hypot(shift, rim * turn))


def _halved(bounds: PathBounds, poses: FloatArray, margin: float, aim: float, turns: bool) -> list[tuple[float, FloatArray]]:
    """Parameters and poses of the path, each led around, with more of them where the way between two does not keep the limits."""
    kept = np.asarray((bounds.values(poses) >= margin).all(axis=1))
    found: list[tuple[float, FloatArray]] = []
    for k, pose in enumerate(poses):
        before = found[-1][1] if found and not kept[k] else None
        found.append((float(k), pose if kept[k] else nearest_pose(bounds, pose, margin, before, aim=aim, turns=turns)))
    for _ in range(HALVINGS):
        more: list[tuple[float, FloatArray]] = [found[0]]
        middles = np.array([at(np.stack([a, b]), 0.5) for (_, a), (_, b) in pairwise(found)])
        missed = np.asarray((bounds.values(middles) < margin).any(axis=1))
        for ((i, _), (j, b)), middle, misses in zip(pairwise(found), middles, missed, strict=True):
            if misses:
                more.append(((i + j) / 2.0, nearest_pose(bounds, at(poses, (i + j) / 2.0), margin, middle, aim=aim, turns=turns)))
            more.append((j, b))
        if len(more) == len(found):
            break  # between no two the limits are missed
        found = more
    return found


def _short(bounds: PathBounds, found: list[tuple[float, FloatArray]], margin: float) -> tuple[float, int]:
    """Return the shortfall of the worst place between the poses from the margin, and the sample before it."""
    between = np.array([at(np.stack([a, b]), part) for (_, a), (_, b) in pairwise(found) for part in (0.25, 0.5, 0.75)])
    short = margin - np.nan_to_num(bounds.values(between), nan=-np.inf).min(axis=1)
    worst = int(np.argmax(short))
    return max(float(short[worst]), 0.0), int(found[worst // 3][0])


def nearest_pose(
    bounds: PathBounds,
    pose: FloatArray,
    margin: float = 0.0,
    start: FloatArray | None = None,
    *,
    aim: float | None = None,
    turns: bool = True,
) -> FloatArray:
    """The pose (7,) nearest to a pose that keeps all limits: least displacement under the limits made linear, again and again. start (7,):
    where to begin, by default the pose itself; aim: by how much limits are kept where the pose does not keep the margin, by default that;
    turns: whether the body may be turned. StructureError where none is found."""
    if (bounds.values(pose) >= margin).all():
        return pose
    aim = margin if aim is None else aim
    # a body that is not turned has no rim that would matter: its places are distinguished by the size of the rig
    rim = rim_mm(bounds.body) if turns else max(rim_mm(bounds.body), 0.1 * rim_mm(bounds.base))
    unit = np.diag(np.repeat([1.0 / rim, 1.0], 3))[:, 0 if turns else 3 :]
    now = np.zeros(unit.shape[1]) if start is None else (se3.displacement(start, pose) * np.repeat([rim, 1.0], 3))[0 if turns else 3 :]
    for _ in range(STEPS):
        values, rates = _linear(bounds, pose, now, unit, rim)
        if not (np.isfinite(values).all() and np.isfinite(rates).all()):
            break
        then = _least(rates, aim - values + rates @ now)
        if then is None:
            break
        step = then - now
        size = float(np.linalg.norm(step))
        # far from a limit its linear form is worth little
        now = now + step * min(1.0, 0.5 * rim / max(size, 1e-300))
        if size <= SETTLED * rim:
            out = se3.displaced(pose, unit @ now)
            if (bounds.values(out) >= aim - INSIDE).all():
                return out
    raise StructureError(message("error.path_no_pose_near"))


def _linear(bounds: PathBounds, pose: FloatArray, now: FloatArray, unit: FloatArray, rim: float) -> tuple[FloatArray, FloatArray]:
    """(k,) limits at a displacement now (q,) from the pose, and (k, q) their rates; unit (6, q): its directions, in mm of the rim."""
    # so far because cables over pulleys are known to 1e-13 of their limits only
    step, each = 1e-4 * rim, np.eye(len(now))
    here, ahead, behind = np.split(
        bounds.values(se3.displaced(pose, (now + step * np.vstack([0.0 * now, each, -each])) @ unit.T)), [1, 1 + len(now)]
    )
    return here[0], np.asarray(((ahead - behind) / (2.0 * step)).T)


def _least(A: FloatArray, b: FloatArray) -> FloatArray | None:
    """The least x with A x >= b (Lawson and Hanson, Solving Least Squares Problems, 1974, ch. 23); None where there is none."""
    scale = np.maximum(np.linalg.norm(A, axis=1), 1e-300)
    A, b = A / scale[:, None], b / scale
    if (b <= 0.0).all():
        return np.zeros(A.shape[1])
    u, _ = nnls(np.vstack([A.T, b]), np.r_[np.zeros(A.shape[1]), 1.0])
    r = np.r_[A.T @ u, b @ u] - np.r_[np.zeros(A.shape[1]), 1.0]
    return None if abs(r[-1]) < 1e-14 else np.asarray(-r[:-1] / r[-1])


def at(poses: FloatArray, t: float) -> FloatArray:
    """(7,) the pose at a parameter t between poses (n, 7): straight, and turned about one axis."""
    k = min(int(t), len(poses) - 2)
    return se3.displaced(poses[k], (t - k) * se3.displacement(poses[k + 1], poses[k]))


def _ways(poses: FloatArray, rim: float) -> FloatArray:
    """(n - 1,) ways between poses (n, 7) [mm], a turn counted at the rim."""
    step = se3.displacement(poses[1:], poses[:-1])
    return np.hypot(np.linalg.norm(step[:, 3:], axis=1), rim * np.linalg.norm(step[:, :3], axis=1))
