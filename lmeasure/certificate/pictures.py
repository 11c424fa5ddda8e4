"""Data of a certificate's pictures: scatter of attained poses, deviation and speed along paths, drift. No drawing here."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from lmeasure.core import FloatArray
from lmeasure.iso9283 import Evaluation
from lmeasure.trajectory import AttainedPose, Trajectory

PLANES = ((0, 1), (0, 2), (1, 2))
COVERAGE = 0.95
MOST_POINTS = 20_000
ROUNDING_MM = 1e-6
"""Scatter [mm] below which it is only rounding."""
READABLE = 0.9
"""Largest size of an enlarged scatter, as a part of the mean's distance from the command."""


@dataclass(frozen=True)
class Target:
    """The cycles of one pose seen from one side: deviations (n, 2) [mm] from the commanded position along two axes, their mean (2,), the
    ellipse (m, 2) that holds 95 % of further cycles (None for fewer than four cycles), and a rounded radius around everything.

    enlarged: factor by which the scatter about the mean, and the ellipse, are larger than they are.
    """

    pose: str
    axes: tuple[int, int]
    deviations: FloatArray
    mean: FloatArray
    ellipse: FloatArray | None
    radius: float
    enlarged: float = 1.0


def targets(pose: AttainedPose, *, readable: bool = False) -> list[Target]:
    """Return views of a pose from above, from the front and from the side.

    readable: for paper, which has no zoom: enlarge a scatter that is small beside the mean's distance.
    """
    deviations = pose.poses[:, :3] - pose.commanded[:3]
    mean = deviations.mean(axis=0)
    scatter = deviations - mean
    factor = 1.0
    if readable and (largest := float(np.linalg.norm(scatter, axis=1).max())) > ROUNDING_MM:
        factor = max(1.0, round_down(READABLE * float(np.linalg.norm(mean)) / largest))
    deviations = mean + factor * scatter
    seen = [(axes, deviations[:, axes], prediction_ellipse(deviations[:, axes])) for axes in PLANES]
    far = max(float(np.abs(part).max()) for _, d, e in seen for part in (d, e) if part is not None)
    radius = round_scale(far)
    return [Target(pose.name, axes, d, d.mean(axis=0), e, radius, factor) for axes, d, e in seen]


def prediction_ellipse(points: FloatArray, corners: int = 73) -> FloatArray | None:
    """(corners, 2) closed line that holds a further point of the same normal law with 95 %; None for fewer than four points.

    Hotelling: (x - mean)' S^-1 (x - mean) is distributed as 2 (n + 1)(n - 1) / (n (n - 2)) F(2, n - 2).
    """
    n = len(points)
    if n < 4:
        return None
    size = 2.0 * (n + 1) * (n - 1) / (n * (n - 2)) * scipy.special.fdtri(2, n - 2, COVERAGE)
    values, vectors = np.linalg.eigh(np.cov(points.T))
    turn = np.linspace(0.0, 2.0 * np.pi, corners)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    return np.asarray(points.mean(axis=0) + (circle * np.sqrt(size * np.maximum(values, 0.0))) @ vectors.T)


def round_up(value: float, steps: Sequence[float] = (1.0, 2.0, 5.0, 10.0)) -> float:
    """The next of the steps, 1, 2 or 5, times a power of ten."""
    if not value > 0:
        return 1e-3
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(m * power for m in steps if m * power >= value * (1 - 1e-12)))


ROUND = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)


def round_scale(value: float) -> float:
    """The next round end of a scale, which is then not half empty."""
    return round_up(value, ROUND)


def round_down(value: float) -> float:
    """The round number before a positive one."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max((m * power for m in ROUND if m * power <= value * (1 + 1e-12)), default=power))


def magnification(evaluation: Evaluation) -> float:
    """Return the factor that enlarges deviations in space to about a twentieth of the program's extent."""
    commanded = [p.commanded[None, :3] for p in evaluation.poses] + [p.commanded for p in evaluation.paths]
    deviations = [p.poses[:, :3] - p.commanded[:3] for p in evaluation.poses]
    deviations += [(p.attained - p.commanded).reshape(-1, 3) for p in evaluation.paths]
    if not commanded:
        return 1.0
    places = np.concatenate(commanded)
    extent = float(np.linalg.norm(places.max(axis=0) - places.min(axis=0))) or 100.0
    largest = float(np.nanmax(np.abs(np.concatenate(deviations)), initial=0.0))
    return max(1.0, round_up(extent / 20.0 / largest) if largest > 0 else 1.0)


def way(trajectory: Trajectory) -> FloatArray:
    """(m, 3) positions of the whole measurement, few enough to be drawn; gaps are NaN."""
    step = max(1, -(-len(trajectory.poses) // MOST_POINTS))
    return trajectory.poses[::step, :3]
