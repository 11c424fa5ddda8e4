"""By how much a robot that was corrected is nearer to where it was sent, and what keeps it from being nearer still.

A measured distance from a commanded pose is too long on the average: what the robot scatters by and the instrument errs by has a length of
its own. So the least mean distance is found by test inversion: the smallest, along the measured one, under which so much would not be
improbable. The largest is the larger of two: a robot that was corrected by the same instrument stands where that instrument sees it right,
so that its measured distance tells nothing of what both measurements err by, and the true errors are the measured ones less that.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lmeasure.certificate.compare import Attained, attained, commanded_otherwise
from lmeasure.core import CertificationError, FloatArray
from lmeasure.text import message

DRAWS = 2000
OUTSIDE = 0.0125
"""Of the draws at each end of an interval of a mean distance: the quotient of two such intervals holds the true one with 95 % at least."""
LARGEST, HALVINGS = 4.0, 24
"""Multiples of a measured distance that are looked among, in units of it and of its noise, and how finely."""


@dataclass(frozen=True)
class Parts:
    """Standard uncertainties of an attained mean [mm], all three coordinates together, as root mean square over the poses: by the
    instrument, by the robot's scatter over the root of its cycles, and by what its identification left; None where that is not known."""

    instrument_mm: float
    scatter_mm: float
    identified_mm: float | None


@dataclass(frozen=True)
class Improvement:
    """Errors of poses by name: commanded (k, 3) places, errors (k, 3) [mm] attained less commanded before and after; mean distances, each
    with the
    least and the largest that its noise leaves; floor_mm: the mean distance that the parts alone would show of a robot without any other
    error."""

    poses: tuple[str, ...]
    commanded: FloatArray
    before: FloatArray
    after: FloatArray
    before_mm: tuple[float, float, float]
    after_mm: tuple[float, float, float]
    parts: Parts
    floor_mm: float

    @property
    def factor(self) -> float:
        """Mean distance before over that after."""
        return self.before_mm[0] / self.after_mm[0]

    @property
    def factor_95(self) -> tuple[float, float]:
        """Least and largest factor, at 95 % or more; the largest is infinite where what is left cannot be determined from nothing."""
        low, high = self.before_mm[1] / self.after_mm[2], self.before_mm[2]
        return low, high / self.after_mm[1] if self.after_mm[1] > 0.0 else math.inf


def improvement(
    first: dict[str, Any], later: dict[str, Any], identified_mm: Mapping[str, float] | None = None, seed: int = 0
) -> Improvement:
    """Return the improvement between two certificates of one program, before and after; identified_mm: by pose, the standard uncertainty
    that its correction has by the identification. CertificationError where they have no pose in common that was commanded alike."""
    other = commanded_otherwise(first, later)
    old, new = attained(first), attained(later)
    names = tuple(pose for pose in old if pose in new and ("pose", pose) not in other)
    if not names:
        raise CertificationError(message("error.the_certificates_have_no"))
    before, after = ([of[name] for name in names] for of in (old, new))
    rng = np.random.default_rng(seed)
    noise = [_noise(rows, rng) for rows in (before, after)]
    errors = [np.array([row.mean - row.commanded for row in rows]) for rows in (before, after)]
    known = None if identified_mm is None else np.array([identified_mm.get(name, math.nan) for name in names])
    left = None if known is None or np.isnan(known).any() else float(np.sqrt(np.mean(known**2)))
    own = np.zeros(len(names)) if left is None or known is None else known / math.sqrt(3.0)
    whole = noise[1] + own[:, None] * rng.normal(size=(DRAWS, len(names), 3))
    parts = Parts(_rms([row.random**2 + row.systematic**2 for row in after]), _rms([np.diag(r.scatter) / r.cycles for r in after]), left)
    reported = [_mean_distance(e, n) for e, n in zip(errors, noise, strict=True)]
    commanded = np.array([row.commanded for row in before])
    return Improvement(names, commanded, errors[0], errors[1], reported[0], reported[1], parts, float(np.linalg.norm(whole, axis=2).mean()))


def _rms(variances: list[FloatArray]) -> float:
    """Root of the mean over poses of the sum over coordinates."""
    return float(np.sqrt(np.mean(np.sum(variances, axis=1))))


def _noise(rows: list[Attained], rng: np.random.Generator) -> FloatArray:
    """(`DRAWS`, k, 3) errors of attained means: each pose's own, and the instrument's systematic ones, which move all poses together."""
    own = np.array([np.linalg.cholesky(row.scatter / row.cycles + np.diag(row.random**2) + 1e-18 * np.eye(3)) for row in rows])
    drawn = np.einsum("kij,nkj->nki", own, rng.normal(size=(DRAWS, len(rows), 3)))
    return np.asarray(drawn + np.array([row.systematic for row in rows]) * rng.normal(size=(DRAWS, 1, 3)))


def _mean_distance(errors: FloatArray, noise: FloatArray) -> tuple[float, float, float]:
    """(measured, least, largest) mean distance [mm] of errors (k, 3) that have such noise."""
    measured = float(np.linalg.norm(errors, axis=1).mean())
    if measured == 0.0:
        return 0.0, 0.0, float(np.quantile(np.linalg.norm(noise, axis=2).mean(axis=1), 1.0 - OUTSIDE))

    def beyond(part: float) -> float:
        """Return how often a robot of so much of the errors would show more than was measured."""
        return float(np.mean(np.linalg.norm(part * errors + noise, axis=2).mean(axis=1) > measured))

    def bound(probability: float) -> float:
        low, high = 0.0, LARGEST * (1.0 + float(np.linalg.norm(noise, axis=2).mean()) / measured)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if beyond(middle) < probability else (low, middle)
        return 0.5 * (low + high)

    least = 0.0 if beyond(0.0) >= OUTSIDE else bound(OUTSIDE)
    shared = float(np.quantile(np.linalg.norm(errors - noise, axis=2).mean(axis=1), 1.0 - OUTSIDE))
    return measured, measured * least, max(measured * bound(1.0 - OUTSIDE), shared)
