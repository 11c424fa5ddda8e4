"""In words: what the cables still tell where they do not tell the pose (`linkages.lost_screw`)."""

import numpy as np

from lmeasure.core import FloatArray, IntArray, se3
from lmeasure.kernels import ATTACHMENT_XYZ
from lmeasure.linkages import Split
from lmeasure.sensors import span_rows
from lmeasure.text import Finding, finding

PROBES = 12  # to either side of a pose
NEWTON_STEPS = 15
SOLVED_MM, APART_MM = 1e-6, 1e-2
"""Lengths met, and poses farther apart than a solution of the same one ends."""
NEARLY = 88.0  # worst pressure angle [deg] from which a pose that is known says what is seen badly


def split_at(cables: FloatArray, pose: FloatArray, free: IntArray, u: FloatArray) -> Split:
    """The split at a pose (7,) of cables (m, columns) with free components free (f,) of the twist and uncertain by u (m,) [mm]."""
    size = max(float(np.linalg.norm(cables[:, ATTACHMENT_XYZ], axis=1).max()), 1e-3)
    return Split(span_rows(cables, pose[None])[1][0], pose[:3], free, u, size_mm=size)


def explain(split: Split, changes: FloatArray) -> list[Finding]:
    """For each of n samples with changes (n, m) [mm] since the pose of the split: what is lost there, and what is determined."""
    twists, u = split.determined(changes)
    size = {"mm": float(np.linalg.norm(u[3:])), "deg": float(np.degrees(np.linalg.norm(u[:3])))}
    lost = finding("cause.lost", screw=split.lost.said)

    def said(twist: FloatArray) -> Finding:
        moved = {"shift": tuple(twist[3:].tolist()), "turn": tuple(np.degrees(twist[:3]).tolist())}
        return finding("cause.lost.determined", screw=split.lost.said, **size, **moved)

    return [said(twist) if np.isfinite(twist).all() else lost for twist in twists]


def other_near(cables: FloatArray, start: FloatArray, within_mm: float) -> tuple[FloatArray, float] | None:
    """The nearest other pose (7,) with the lengths that six cables (6, columns) have at a pose (7,), and how far it is [mm], a turn counted
    at the rim; None where none is met within a distance.

    Two assemblies meet at a fold, a singular pose, and near one they lie apart along the screw that the lengths see least: Newton's method
    from places along it, to both sides, ends at the other one.
    """
    six = np.arange(6)
    twist, rim = split_at(cables, start, six, np.ones(6)).twist, max(float(np.linalg.norm(cables[:, ATTACHMENT_XYZ], axis=1).max()), 1e-3)
    unit = np.repeat([1.0 / rim, 1.0], 3)
    aim = span_rows(cables, start[None])[0]
    reach = within_mm * np.geomspace(1.0, 1e-3, PROBES)
    poses = se3.displaced(np.tile(start, (2 * PROBES, 1)), np.outer(np.concatenate([reach, -reach]), twist))
    for _ in range(NEWTON_STEPS):
        lengths, rows = span_rows(cables, poses)
        sound = np.isfinite(rows).all(axis=(1, 2)) & (np.linalg.cond(np.nan_to_num(rows * unit)) < 1e14)
        poses, rows, lengths = poses[sound], rows[sound] * unit, lengths[sound]
        step = np.linalg.solve(rows, (aim - lengths)[..., None])[..., 0]
        # farther than what is looked for is not gone at once
        step *= np.minimum(1.0, within_mm / np.maximum(np.linalg.norm(step, axis=1), 1e-300))[:, None]
        poses = se3.displaced(poses, step * unit)
    lengths = span_rows(cables, poses)[0]
    away = np.linalg.norm(se3.displacement(poses, start) / unit, axis=1)
    with np.errstate(invalid="ignore"):
        found = np.flatnonzero((np.abs(lengths - aim).max(axis=1) < SOLVED_MM) & (away > APART_MM) & (away <= within_mm))
    if not len(found):
        return None
    nearest = found[np.argmin(away[found])]
    return poses[nearest], float(away[nearest])
