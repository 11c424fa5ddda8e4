"""Least sizes of slow faults that returns and reversals show where no cable is redundant: lost counts, a moved point, warmth, lateness.

With the limit c from which two visits of a position do not agree, lost counts show from c, a point that moved along its cable from c,
and in any direction from c sqrt(k) / s, with s the least singular value of the directions of the cable at k positions. A warmer rig shows
in two cables at least, from c / (a L) kelvin, a the expansion of steel and L the second longest cable.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.kernels import AXIAL, TANGENT, span_lengths, span_rows_of
from lmeasure.rig import STEEL_PER_K, Rig
from lmeasure.text import Message, message

FLAT = 0.05  # Least singular value of the directions at several positions from which they show a point that moved in any direction

CLOSED_COUNTS = 3.0
CLOSED_MM = 0.1
CLOSED_SCATTERS = 5.0  # Of the difference of two visits: up to these the counts close; the second is what robots drift by
ALONE = 8.0  # Times as much as the other channels together (root mean square): a robot that steps moves several cables
REPEATS_MM = 0.02  # Repeatability of a robot for which returns are planned, as lengths of cables
SIX = 6
RETURNS = 3  # Positions that are proposed


@dataclass(frozen=True)
class DetectableSizes:
    """Least sizes that a run shows, infinite where it shows none. positions: visited again; lost_mm: of lost counts of a channel;
    along_mm, moved_mm: of a point that moved along its cable, or in any direction; late_s: of a channel against the others."""

    positions: int = 0
    lost_mm: float = np.inf
    along_mm: float = np.inf
    moved_mm: float = np.inf
    warmer_k: float = np.inf
    late_s: float = np.inf

    @property
    def lines(self) -> list[Message]:
        """Return the lines for a person: the sizes, and what nothing shows."""
        shown = self.sizes
        lines = [message("detectable.sizes", positions=self.positions, sizes=shown)] if shown else []
        if not np.isfinite(self.lost_mm):
            lines.append(message("detectable.no_return"))
        elif not np.isfinite(self.moved_mm):
            lines.append(message("detectable.few_returns"))
        return lines if np.isfinite(self.late_s) else [*lines, message("detectable.no_reversal")]

    @property
    def sizes(self) -> tuple[Message, ...]:
        """Return the sizes of the faults that show."""
        lengths = {"lost": self.lost_mm, "along": self.along_mm, "moved": self.moved_mm}
        sizes = [(kind, "mm", mm) for kind, mm in lengths.items()]
        sizes += [("warmer", "kelvin", self.warmer_k), ("late", "ms", 1e3 * self.late_s)]
        return tuple(message(f"detectable.{kind}", **{unit: size}) for kind, unit, size in sizes if np.isfinite(size))


def detectable_sizes(
    lost_mm: FloatArray, return_mm: FloatArray, directions: FloatArray, lengths_mm: FloatArray, *, late_s: float = np.inf
) -> DetectableSizes:
    """Return the least sizes by the limits (m,) of all visits and of two, and by unit directions (k, m, 3) of the cables and their free
    lengths (k, m) at the positions that are visited again."""
    if not len(directions):
        return DetectableSizes(late_s=late_s)
    k, m = directions.shape[:2]
    least = np.array([np.linalg.svd(directions[:, j], compute_uv=False)[-1] if k >= 3 else 0.0 for j in range(m)])
    moved = return_mm * np.sqrt(k) / least if (least > FLAT).all() else np.array([np.inf])
    second = np.sort(return_mm / (STEEL_PER_K * lengths_mm.max(axis=0)))[1] if m > 1 else np.inf
    return DetectableSizes(k, float(lost_mm.max()), float(return_mm.max()), float(moved.max()), float(second), late_s)


def proposed_returns(rig: Rig, poses: FloatArray, names: Sequence[str], speed_mm_s: float | None = None) -> list[Message]:
    """Return a line that proposes which of (n, 7) poses to visit again at the end, and a path forth and back at a speed, and states what
    these show. No line for a rig that has other than six cables, whose redundant channels show more, or with fewer than three poses.

    The first pose shows lost counts. The others are those that add most to the directions of the cable that sees a moved point worst.
    """
    rows = rig.cable_rows()
    if len(rows) != SIX or rig.sensors or len(poses) < RETURNS:
        return []
    every = span_rows_of(rows, np.ascontiguousarray(poses))[:, :, 3:]
    chosen = [0]
    while len(chosen) < RETURNS:
        others = [i for i in range(len(poses)) if i not in chosen]
        seen = [np.linalg.svd(np.swapaxes(every[[*chosen, i]], 0, 1), compute_uv=False)[:, len(chosen)].min() for i in others]
        chosen.append(others[int(np.argmax(seen))])
    count_mm = np.array([(drum := rig.point(c.from_point).drum).count_length_mm / abs(drum.scale) for c in rig.cable])
    limit = np.maximum(np.maximum(CLOSED_COUNTS * count_mm, CLOSED_MM), ALONE * REPEATS_MM)
    lengths = span_lengths(rows, np.ascontiguousarray(poses[chosen])) + np.hypot(rows[:, TANGENT], rows[:, AXIAL])
    # a cable runs with the root of a third of the tool's speed, over all directions
    late_s = np.inf if speed_mm_s is None else float(limit.max()) * np.sqrt(3.0) / (2.0 * speed_mm_s)
    found = detectable_sizes(limit, limit, every[chosen], lengths, late_s=late_s)
    where = tuple(names[i] for i in sorted(chosen))
    if speed_mm_s is None:
        return [message("detectable.proposed", poses=where, sizes=found.sizes)]
    return [message("detectable.proposed_path", poses=where, speed=speed_mm_s, sizes=found.sizes)]
