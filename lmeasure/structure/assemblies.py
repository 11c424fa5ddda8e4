"""All assemblies of lengths: of six straight links proved, of more links those of six that close the others, of wrapped cables followed.

With seven and more links a pose that closes them all is one of the assemblies of any six: if these are complete, so are they. Any six will
do: those with the fewest complex assemblies are solved, in closed form if possible. Measured lengths close only within their errors; a pose
that misses none by more than a stated length is kept, improved by least squares, with its largest miss.
"""

from dataclasses import dataclass
from itertools import combinations, islice

import numpy as np

from lmeasure import linkages
from lmeasure.core import BoolArray, FloatArray, se3
from lmeasure.linkages import rim_mm
from lmeasure.sensors import span_rows
from lmeasure.structure.links import Linkage

WITHIN_MM = 0.5  # tolerance for redundant links: far more than errors of cables, far less than other assembly modes
SIXES = 40  # of redundant links that are looked at
SAME_MM = 1e-3  # a turn counted at the rim
IMPROVED = 10  # steps of least squares


@dataclass(frozen=True)
class AssemblyResult:
    """poses (k, 7) base_from_platform; certified (k,): proved to be exactly one assembly; misses_mm (k,): largest |length - given|.
    complex_found of complex_expected: as `straight.Assemblies`, of the six links that were solved; None of cables that are wrapped.
    next_misses_mm: how far the best of those misses that fit six links but not the others; infinite where there is none."""

    poses: FloatArray
    certified: BoolArray
    misses_mm: FloatArray
    status: str
    complex_found: int | None
    complex_expected: int | None
    next_misses_mm: float = float("inf")


def found_of(linkage: Linkage, lengths: FloatArray, within_mm: float = WITHIN_MM) -> AssemblyResult:
    """Assemblies of lengths (m,) [mm]; six of the links must hold the platform somewhere."""
    if linkage.rods is not None:
        return _of_rods(linkage.rods, lengths)
    six = six_of(linkage)
    base, platform = linkage.base[six], linkage.platform[six]
    proofs = linkages.assemblies(base, platform, lengths[six])
    if linkage.wrapped is None:
        poses, certified, status = proofs.poses, proofs.certified, proofs.status
        counts: tuple[int | None, int | None] = (proofs.complex_found, proofs.complex_expected)
    else:
        poses, _ = linkages.wrapped_assemblies(linkage.wrapped[six], lengths[six])
        certified, status, counts = np.zeros(len(poses), dtype=np.bool_), linkages.NOT_PROVED, (None, None)
    if len(lengths) == linkages.LINKS:
        return AssemblyResult(poses, certified, _misses(linkage, poses, lengths), status, *counts)
    near = _misses(linkage, poses, lengths) <= 100.0 * within_mm
    poses = np.where(near[:, None], np.array([_improved(linkage, pose, lengths) for pose in poses]).reshape(-1, 7), poses)
    misses = _misses(linkage, poses, lengths)
    kept = (misses <= within_mm) & _first(poses, rim_mm(linkage.platform))
    rest = float(misses[misses > within_mm].min(initial=np.inf))
    # that one pose closes more than six links cannot be proved by numbers
    return AssemblyResult(poses[kept], np.zeros(int(kept.sum()), dtype=np.bool_), misses[kept], status, *counts, rest)


def _of_rods(rods: linkages.RodLinks, lengths: FloatArray) -> AssemblyResult:
    """Return the modes of straight links with the same poses, or modes found from many starts where there are no such links."""
    if rods.gauges is None:
        poses = rods.poses_of(lengths)
        return AssemblyResult(poses, np.zeros(len(poses), dtype=np.bool_), np.zeros(len(poses)), linkages.NOT_PROVED, None, None)
    links = rods.links_of_drives(lengths)
    if not np.isfinite(links).all():
        return AssemblyResult(np.empty((0, 7)), np.zeros(0, dtype=np.bool_), np.zeros(0), linkages.ALL, 0, 0)
    proofs = linkages.assemblies(*rods.bodies, links)
    misses = np.abs(rods.placed(proofs.poses).lengths - lengths).max(axis=1)
    return AssemblyResult(proofs.poses, proofs.certified, misses, proofs.status, proofs.complex_found, proofs.complex_expected)


def six_of(linkage: Linkage) -> list[int]:
    """Six of the links, those with fewest complex assemblies of the first SIXES choices; all when there are six."""
    m, best, fewest = len(linkage.base), list(range(linkages.LINKS)), np.inf
    if m == linkages.LINKS:
        return best
    for choice in islice(combinations(range(m), linkages.LINKS), SIXES):
        six = list(choice)
        count = _count(linkage.base[six], linkage.platform[six])
        if 0 < count < fewest:
            best, fewest = six, count
        if fewest <= 8:
            break
    return best


def _count(base: FloatArray, platform: FloatArray) -> int:
    structure = linkages.incidence(base, platform).structure
    if structure.degenerate or linkages.architecturally_singular(base, platform):
        return 0
    return linkages.complex_assemblies(structure)


def lengths_at(linkage: Linkage, poses: FloatArray) -> FloatArray:
    """(n, m) lengths at poses (n, 7) [mm]."""
    return rows_at(linkage, poses)[0]


def rows_at(linkage: Linkage, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, m) lengths and (n, m, 6) their rates by displacements of the platform's origin."""
    if linkage.wrapped is not None:
        return span_rows(linkage.wrapped, poses)
    if linkage.rods is not None:
        found = linkage.rods.placed(poses)
        rows = found.rows
        return found.lengths, np.concatenate([rows[..., :3] - np.cross(poses[:, None, :3], rows[..., 3:]), rows[..., 3:]], axis=-1)
    arms = np.einsum("nij,mj->nmi", se3.matrices(poses), linkage.platform)
    along = poses[:, None, :3] + arms - linkage.base
    lengths = np.linalg.norm(along, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return lengths, linkages.pluecker_rows(arms, along / lengths[..., None])


def _misses(linkage: Linkage, poses: FloatArray, lengths: FloatArray) -> FloatArray:
    return np.abs(lengths_at(linkage, poses) - lengths).max(axis=1) if len(poses) else np.empty(0)


def _improved(linkage: Linkage, pose: FloatArray, lengths: FloatArray) -> FloatArray:
    """The pose (7,) of least squares of all lengths near a pose; the pose itself where that leads away."""
    start = pose
    rim = max(float(np.ptp(linkage.platform, axis=0).max()), 1e-3)
    unit = np.repeat([1.0 / rim, 1.0], 3)
    for _ in range(IMPROVED):
        now, rows = rows_at(linkage, pose[None])
        if not np.isfinite(rows).all():
            return start
        step = unit * np.linalg.lstsq(rows[0] * unit, lengths - now[0], rcond=1e-9)[0]
        if not float(np.abs(step / unit).max()) < 0.5 * rim:
            return start
        pose = se3.displaced(pose, step)
    return pose


def _first(poses: FloatArray, rim: float) -> BoolArray:
    """(k,) which of the poses (k, 7) are none of those before: least squares may lead two to one."""
    return np.array([not (apart_mm(poses[:i], pose, rim) < SAME_MM).any() for i, pose in enumerate(poses)], dtype=np.bool_)


def apart_mm(poses: FloatArray, pose: FloatArray, rim_mm: float) -> FloatArray:
    """(k,) how far poses (k, 7) are from a pose (7,) [mm], a turn counted at the rim."""
    step = se3.displacement(poses, pose) if len(poses) else np.empty((0, 6))
    return np.asarray(np.hypot(np.linalg.norm(step[:, 3:], axis=1), rim_mm * np.linalg.norm(step[:, :3], axis=1)))
