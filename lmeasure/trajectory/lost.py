"""In words: what the cables still tell where they do not tell the pose (`lcoordinate.singular`)."""

import numpy as np

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.findings import Finding, finding
from lmeasure.kernels.layout import ATTACHMENT_XYZ
from lmeasure.lcoordinate.singular import Split
from lmeasure.observation.wrap import span_rows

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
