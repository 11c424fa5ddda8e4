"""All assemblies of six straight links of given lengths, each proved, with a test for completeness (thesis 4.1).

Structures that tetrahedra solve have eight complex assemblies in closed form; of all others they are followed from a start system of the
same structure (`starts`). The found ones are proved one by one (`certified`). A structure has no more isolated assemblies than a generic
platform of it, and special points no more than with generic lengths. If so many different ones are proved, real and complex ones together,
there are no others.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import BoolArray, ComplexArray, FloatArray, se3
from lmeasure.kernels import REACHED, follow_homotopy
from lmeasure.linkages import krawczyk, start_systems, study_quadric
from lmeasure.linkages.krawczyk import ExactLinks
from lmeasure.linkages.tetrahedra import complex_points
from lmeasure.linkages.topology import Incidence, incidence
from lmeasure.text import message

ALL, NOT_PROVED = message("linkages.all_accounted"), message("linkages.not_proved")
TRIES = 3  # ways to the same links, should paths be lost or meet on one
IMPROPER = 1e-9  # |e.e| of a point of length one below which it is no pose: paths that end there end at 1e-20, others above 1e-4
CLOSES = 1e-9  # relative to the rig's size: a pose with lengths this near is an assembly mode numerically


@dataclass(frozen=True)
class Assemblies:
    """Real assemblies, base_from_platform."""

    poses: FloatArray
    """(k, 7)"""
    certified: BoolArray
    """(k,) whether it is proved that exactly one assembly is there."""
    complex_found: int
    """Number of different assembly modes that are proved, real and complex."""
    complex_expected: int
    """Number of assemblies with generic lengths: of the structure, or fewer for special points."""

    @property
    def status(self) -> str:
        """ALL where there can be no other assembly, else NOT_PROVED."""
        return ALL if self.complex_found == self.complex_expected > 0 else NOT_PROVED


def assemblies(base: FloatArray, platform: FloatArray, lengths: FloatArray) -> Assemblies:
    """Return the assembly modes of six links of lengths (6,) [mm] from points base (6, 3) in the base frame to points platform (6, 3) in
    the platform's."""
    found = incidence(base, platform)
    expected = start_systems.complex_assemblies(found.structure)
    at, of, unit = base.mean(axis=0), platform.mean(axis=0), _unit(base, platform, lengths)
    exact = ExactLinks.of(base, platform, lengths, origins=(at, of), size=unit)
    a, b, lengths = (base - at) / unit, (platform - of) / unit, lengths / unit
    rows = study_quadric.links(a, b, lengths**2)
    points, sure = np.empty((0, 8), dtype=np.complex128), np.empty(0, dtype=np.bool_)
    real, count, rest = sure, 0, points
    for attempt in range(TRIES if expected else 0):
        more = _near(found, rows, a, b, lengths, attempt)
        determined = krawczyk.proved(rows, np.concatenate([points, more]), exact)
        new = krawczyk.apart(determined)
        points, sure, real = determined.points[new], determined.certain[new], determined.real[new]
        count, rest = len(points), determined.points
        if attempt == 0 and count < expected:
            expected = min(expected, _of_these_points(found, a, b) or expected)
        if count >= expected:
            break
    poses = study_quadric.poses(points[real].real)
    proofs = np.ones(len(poses), dtype=np.bool_)
    if count < expected:
        folds = _folds(a, b, lengths, study_quadric.poses(rest.real), poses)
        poses, proofs = np.concatenate([poses, folds]), np.concatenate([proofs, np.zeros(len(folds), dtype=np.bool_)])
    poses[:, :3] = poses[:, :3] * unit + at
    poses[:, :3] -= se3.matrices(poses) @ of if len(poses) else 0.0
    return Assemblies(poses, proofs, count, expected)


def _unit(base: FloatArray, platform: FloatArray, lengths: FloatArray) -> float:
    """About the rig's size, a power of two: dividing by it rounds nothing."""
    size = max(np.ptp(base, axis=0).max(), np.ptp(platform, axis=0).max(), lengths.max() / 2.0)
    return float(2.0 ** np.round(np.log2(size)))


def _near(found: Incidence, rows: ComplexArray, a: FloatArray, b: FloatArray, lengths: FloatArray, attempt: int) -> ComplexArray:
    """(n, 8) points near assemblies; another attempt takes another way to them."""
    if found.structure.closed_form and attempt == 0:
        return complex_points(found, a, b, lengths)
    return _followed(found, rows, a, b, attempt)[0]


def _followed(found: Incidence, rows: ComplexArray, a: FloatArray, b: FloatArray, attempt: int = 0) -> tuple[ComplexArray, BoolArray]:
    """(n, 8) ends of the paths from the structure's start system to links rows (6, 7), and (n,) which were reached."""
    own = start_systems.one_of_two(found.structure)
    links, points = start_systems.start_of(own)
    mine = rows[list(found.order)]
    if own != found.structure:  # platform and base swapped: the inverse poses
        mine = rows[list(incidence(b, a).order)][:, [3, 4, 5, 0, 1, 2, 6]]
    if attempt:
        between = start_systems.random_links(own, np.random.default_rng(attempt))
        points, determined = follow_homotopy(links, between, points)
        links, points = between, points[determined == REACHED]
    ends, determined = follow_homotopy(links, mine, points)
    return ends if own == found.structure else study_quadric.inverse(ends), determined == REACHED


def _of_these_points(found: Incidence, a: FloatArray, b: FloatArray) -> int:
    """Return the number of complex assemblies of links between these points with generic lengths, drawn twice; 0 if undetermined. Each path
    must end either at an assembly or, without doubt, where there is none."""
    counts = set()
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        ends, reached = _followed(found, study_quadric.links(a, b, rng.normal(size=6) + 1j * rng.normal(size=6)), a, b)
        ee = np.abs((ends[:, :4] ** 2).sum(axis=1))
        if (ee[~reached] > IMPROPER).any() or (ee[reached] < 1e3 * IMPROPER).any():
            return 0
        counts.add(len(start_systems.distinct(ends[reached])))
    return counts.pop() if len(counts) == 1 else 0


def _folds(a: FloatArray, b: FloatArray, lengths: FloatArray, near: FloatArray, known: FloatArray) -> FloatArray:
    """Return (k, 7) poses with the given lengths but without a proof: two assemblies that meet, or nearly."""
    out = list(known)
    for pose in near:
        for _ in range(50):
            away = se3.apply(pose, b) - a
            now = np.linalg.norm(away, axis=1)
            if not np.isfinite(now).all() or now.min() < 1e-12:
                break
            e = away / now[:, None]
            rows = np.concatenate([np.cross(away + a - pose[:3], e), e], axis=1)
            step = np.linalg.lstsq(rows, lengths - now, rcond=1e-9)[0]
            if np.abs(step).max() > 1.0:
                break
            pose = se3.displaced(pose, step)
        else:
            now = np.linalg.norm(se3.apply(pose, b) - a, axis=1)
            if np.abs(now - lengths).max() < CLOSES and not any(np.abs(se3.displacement(pose, other)).max() < 1e-5 for other in out):
                out.append(pose)
    return np.array(out[len(known) :]).reshape(-1, 7)
