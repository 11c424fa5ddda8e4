"""A run of any channels by continuation, block by block of time.

From a pose that is known the first order tells about where the samples behind it lie. Those that lie near are solved together, each from
there, and the last of them is where the next block begins. A sample that is far, as behind a gap, is gone to in parts along the straight
line in readings, so that the way to another assembly is not jumped over.
"""

import math

import numpy as np

from lmeasure.core import FloatArray, IntArray, Status, se3
from reference.channel import Channels, differences, predictions, rows, size_mm
from reference.solver import ALL, Solved, lengths, nowhere, solve_poses, towards

AHEAD = 512  # samples that are looked at together
STRIDE_MM = 40.0  # from a known pose, a turn counted at the size of the tool: the way then bends from the first order by millimetres


def follow(channels: Channels, readings: FloatArray, start: FloatArray, free: IntArray = ALL) -> Solved:
    """The poses of a run whose readings (n, m), NaN where there is none, begin near the start pose (7,); free as in `solve_poses`.

    Two assemblies meet at a singular pose: behind one the samples are OTHER_ASSEMBLY, until more channels can be read than where the run
    was lost. So are those of as many channels as unknowns whose determinant has another sign than at the start.
    """
    counted = np.isfinite(readings).sum(axis=1)
    here, side, lost = start[None], float(_side(channels, start[None], free)[0]), -1
    pieces = [nowhere(np.zeros(0, np.int64))]
    begin = 0
    while begin < len(readings):
        part = slice(begin, begin + AHEAD)
        seen = counted[part] > lost
        if seen[0]:
            found, ended = _until_lost(_near(channels, readings[part], here, free), channels, free, side)
            ok = np.flatnonzero(found.status == Status.OK)
            here, lost = (found.poses[ok[-1:]], -1) if len(ok) else (here, lost)
            lost = int(counted[begin + len(found.status) - 1]) if ended else lost
        else:
            found = nowhere(np.full(len(seen) if not seen.any() else int(np.argmax(seen)), int(Status.OTHER_ASSEMBLY)))
        pieces.append(found)
        begin += len(found.status)
    return Solved(*(np.concatenate(values) for values in zip(*pieces, strict=True)))


def _near(channels: Channels, readings: FloatArray, here: FloatArray, free: IntArray) -> Solved:
    """The first samples of readings (k, m), as many as are near the pose here (1, 7), or one that is far."""
    way, determined = towards(channels, readings, here, free)
    # a sample whose readings tell no pose, which is no way off, is passed over
    length = np.where(determined, lengths(channels, way), 0.0)
    far = ~(length <= STRIDE_MM)
    if far[0]:
        return _in_parts(channels, readings[:1], here, math.ceil(length[0] / STRIDE_MM) if np.isfinite(length[0]) else 1, free)
    near = slice(0, int(np.argmax(far)) if far.any() else len(far))
    return solve_poses(channels, readings[near], se3.displaced(here, way[near]), free)


def _in_parts(channels: Channels, reading: FloatArray, here: FloatArray, parts: int, free: IntArray) -> Solved:
    """A sample with the reading (1, m), gone to from the pose here (1, 7) by equal parts of what the readings change by."""
    begun = predictions(channels, here)
    change = differences(channels, reading, begun)
    for part in range(1, parts + 1):
        # the last part aims at the reading itself, free of the rounding of the sum
        found = solve_poses(channels, begun + part / parts * change if part < parts else reading, here, free)
        if found.status[0] != Status.OK:
            break
        here = found.poses
    return found


def _until_lost(found: Solved, channels: Channels, free: IntArray, side: float) -> tuple[Solved, bool]:
    """What was found up to the first sample behind which assemblies cannot be told apart, that included, and whether there is one."""
    beyond = _side(channels, found.poses, free) * side < 0.0
    ends = beyond | (found.status == Status.SINGULAR)
    for values in found.poses, found.covariance, found.chi2, found.angle:
        values[beyond] = np.nan
    found.status[beyond] = Status.OTHER_ASSEMBLY
    if not ends.any():
        return found, False
    poses, covariance, chi2, status, angle = found
    upto = slice(0, int(np.argmax(ends)) + 1)
    return Solved(poses[upto], covariance[upto], chi2[upto], status[upto], angle[upto]), True


def _side(channels: Channels, poses: FloatArray, free: IntArray) -> FloatArray:
    """(n,) the sign of the rows' determinant at (n, 7) poses, 1 where there are more channels than unknowns, NaN where there is no pose."""
    if len(channels) > len(free):
        return np.ones(len(poses))
    scale, known, out = np.repeat([1.0 / size_mm(channels), 1.0], 3), np.isfinite(poses[:, 0]), np.full(len(poses), np.nan)
    out[known] = np.sign(np.linalg.det((rows(channels, poses[known]) * scale)[:, :, free]))
    return out
