"""All poses that have given lengths of six cables: the assemblies of the mechanism (thesis 4.1).

Where tetrahedra lead from the points of one body to those of the other, as with three cables to one point, two to another and one to a
third, their apexes give every assembly of straight cables; the screw method makes them those of wrapped ones. Of any rig all assemblies of
straight cables are found and proved, and followed while the pulleys grow to their radius. Those that only wrapped cables have are not met
so: many starts over all places and orientations within reach are solved besides, until every assembly has been met several times over.
"""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, FloatArray, Status, se3
from lmeasure.kernels import ATTACHMENT_XYZ, BASE_XYZ, RADIUS, solve_poses
from lmeasure.linkages import straight_links
from lmeasure.linkages.tetrahedra import closed_form

WAY, STEPS = 12, 8  # Parts of the change from the lengths of known poses, and Newton steps after the last part
SINGULAR = 1e-9
"""Least singular value of the rows, lengths in parts of the platform's size, at which a pose is lost."""
Rows = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Function of poses (N, 7) that gives rows (N, m, 6) by twists (omega; v at the base's origin), and lengths (N, m)."""


def driven(rows_of: Rows, poses: FloatArray, lengths: FloatArray, size_mm: float) -> tuple[FloatArray, BoolArray]:
    """Return poses (N, 7) with lengths (N, m), driven there from poses (N, 7), and whether no step met a singular pose (N,).

    size_mm: length at which a turn counts. More than six lengths are met by least squares.
    """
    begun = rows_of(poses)[1]
    good = np.ones(len(poses), np.bool_)
    size = np.array([*(size_mm,) * 3, 1.0, 1.0, 1.0])
    for step in range(1, WAY + STEPS):
        rows, own = rows_of(poses)
        lost = np.asarray(~np.isfinite(rows).all(axis=(1, 2)))
        u, s, vt = np.linalg.svd(np.where(lost[:, None, None], 0.0, rows) / size, full_matrices=False)
        good &= (s[:, -1] > SINGULAR) & ~lost
        off = np.where(lost[:, None], 0.0, begun + min(step / WAY, 1.0) * (lengths - begun) - own)
        twist = np.einsum("nji,nj->ni", vt, np.einsum("nji,nj->ni", u, off) / np.maximum(s, SINGULAR)) / size
        # a lost platform must not run away from the others' numbers
        twist *= np.minimum(1.0, 0.5 * size_mm / np.maximum(np.abs(twist * size).max(axis=1), 1e-300))[:, None]
        at_origin = np.concatenate([twist[:, :3], twist[:, 3:] + np.cross(twist[:, :3], poses[:, :3])], axis=1)
        poses = se3.displaced(poses, at_origin)
    return poses, good


BATCH = 3000  # starts at a time
LEAST, MOST = 2, 12  # batches
MET = 4  # times that each assembly must have been met: one as easy to meet is then missed in 2 % (Poisson)
PARTS = (0.25, 0.5, 0.75, 1.0)  # of the pulleys' radius, one after the other
SAME_MM, SAME_RAD = 1e-5, 1e-6  # two solutions of one pose differ by far less


def wrapped_assemblies(rows: FloatArray, lengths: FloatArray, seed: int = 0) -> tuple[FloatArray, bool]:
    """(k, 7) poses of the tool whose six cables, rows (6, columns), have the lengths (6,) from B over the swivel pulley [mm].

    And whether each was met MET times before the starts were used up: if not, or if there is none, others may have been missed.
    """
    found: list[FloatArray] = []
    met: list[int] = []
    rng = np.random.default_rng(seed)
    for batch in range(MOST):
        starts = _anywhere(rows, lengths, rng)
        if batch == 0:
            corners, _ = closed_form(rows[:, BASE_XYZ], rows[:, ATTACHMENT_XYZ], lengths)
            starts = np.concatenate([corners[np.isfinite(corners).all(axis=1)], starts, _grown(rows, lengths)])
        status, poses = solve_poses(rows, lengths, starts)
        for pose in poses[status == Status.OK]:
            k = next((i for i, other in enumerate(found) if _same(pose, other)), len(found))
            if k == len(found):
                found.append(pose)
                met.append(0)
            met[k] += 1
        if batch + 1 >= LEAST and _enough(met):
            break
    return np.array(found).reshape(len(found), 7), _enough(met)


def _enough(met: list[int]) -> bool:
    return bool(met) and min(met) >= MET


def _anywhere(rows: FloatArray, lengths: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(BATCH, 7) poses over all orientations and all places within reach of every cable."""
    reach = (lengths + np.linalg.norm(rows[:, ATTACHMENT_XYZ], axis=1))[:, None]
    low, high = (rows[:, BASE_XYZ] - reach).max(axis=0), (rows[:, BASE_XYZ] + reach).min(axis=0)
    return se3.pose(rng.uniform(np.minimum(low, high), np.maximum(low, high), (BATCH, 3)), Rotation.random(BATCH, rng=rng))


def _grown(rows: FloatArray, lengths: FloatArray) -> FloatArray:
    """(k, 7) assemblies that those of straight cables of the lengths become while the swivel pulleys grow from points to their radius."""
    poses = straight_links.assemblies(rows[:, BASE_XYZ], rows[:, ATTACHMENT_XYZ], lengths).poses
    for part in PARTS:
        pulleys = rows.copy()
        pulleys[:, RADIUS] *= part
        status, poses = solve_poses(pulleys, lengths, poses)
        poses = poses[status == Status.OK]
    return poses


def _same(a: FloatArray, b: FloatArray) -> bool:
    sign = 1.0 if a[3:] @ b[3:] >= 0.0 else -1.0
    return bool(np.abs(a[:3] - b[:3]).max() <= SAME_MM and 2.0 * np.linalg.norm(a[3:] - sign * b[3:]) <= SAME_RAD)


def by_side(poses: FloatArray, rows: FloatArray, side: FloatArray) -> FloatArray:
    """Those of the (k, 7) poses whose attachment points are all on one side of the middle of the observation points: that to which the
    direction side (3,) shows."""
    middle = np.unique(rows[:, BASE_XYZ], axis=0).mean(axis=0)
    turns = se3.matrices(poses) if len(poses) else np.empty((0, 3, 3))
    points = poses[:, None, :3] + np.einsum("kij,mj->kmi", turns, rows[:, ATTACHMENT_XYZ])
    return poses[((points - middle) @ side > 0.0).all(axis=1)]


def distances(poses: FloatArray, position: FloatArray, quaternion: FloatArray | None, size: float) -> FloatArray:
    """(k,) how far the poses are from a place, and from an orientation where it is given, a radian counting as size [mm]."""
    square = ((poses[:, :3] - position) ** 2).sum(axis=1)
    if quaternion is not None:
        square = square + (size * (se3.rotation(poses) * Rotation.from_quat(quaternion).inv()).magnitude()) ** 2
    return np.asarray(np.sqrt(square))
