"""Start systems: for each structure one platform of complex dimensions with all its assemblies, from which those of any other are followed.

How many there are of a platform whose dimensions are not special depends on its structure alone (Morgan and Sommese, coefficient-parameter
polynomial continuation, 1989). They are found by monodromy and kept in a file; `benchmarks/assembly_counts.py` writes it, and counts
them once more another way.
"""

from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from lmeasure.core import ComplexArray
from lmeasure.kernels import REACHED, follow_homotopy
from lmeasure.linkages import krawczyk, study_quadric
from lmeasure.linkages.topology import Structure, structures

FILE = Path(__file__).with_name("start_systems.npz")
QUIET = 8  # loops that must bring nothing new
TRACE_STEP = 3.0  # of the dimensions
APART = 1e-6  # of points of length one


@cache
def one_of_two(structure: Structure) -> Structure:
    """Return the structure with a start system: itself, or the one with platform and base swapped, whose assemblies are the inverse
    poses."""
    every = structures()
    return min(structure, structure.swapped, key=every.index)


@cache
def of_its_own() -> list[Structure]:
    """The structures with a start system of their own, in order."""
    return [s for s in structures() if s.degenerate is None and one_of_two(s) == s]


@cache
def start_of(structure: Structure) -> tuple[ComplexArray, ComplexArray]:
    """Links (6, 7) and all assemblies (N, 8) of the start system of a structure, one of those `of_its_own`."""
    kept, i = _kept(), of_its_own().index(structure)
    last = int(kept["counts"][: i + 1].sum())
    return kept["links"][i], kept["points"][last - int(kept["counts"][i]) : last]


@cache
def _kept() -> dict[str, np.ndarray]:
    with np.load(FILE) as file:
        return dict(file)


def complex_assemblies(structure: Structure) -> int:
    """Return how many complex assemblies a rig of this structure has when no dimension is special; 0 where it cannot determine a pose."""
    if structure.degenerate is not None:
        return 0
    return int(_kept()["counts"][of_its_own().index(one_of_two(structure))])


def random_links(structure: Structure, rng: np.random.Generator) -> ComplexArray:
    """(6, 7) links of complex dimensions without anything special, with the structure's points in common."""
    platform, base = (_complex(rng, len(degrees), 3) for degrees in structure.degrees)
    of_platform, of_base = np.array(structure.links).T
    return np.concatenate([base[of_base], platform[of_platform], _complex(rng, 6, 1)], axis=1)


def grown(structure: Structure, rng: np.random.Generator) -> tuple[ComplexArray, ComplexArray]:
    """A start system: links (6, 7), and their assemblies (N, 8) as monodromy finds them, until QUIET loops bring none that is new.

    A pose taken at random is an assembly of links whose lengths fit it; followed around loops in the dimensions it goes over into others.
    """
    links, x = random_links(structure, rng), _complex(rng, 8)
    x[4:] -= x[:4] * (x[:4] @ x[4:]) / (x[:4] @ x[:4])
    links[:, 6] = 0.0
    links[:, 6] = -np.einsum("i,nij,j->n", x, study_quadric.quadrics(links)[:6], x) / (x[:4] @ x[:4])
    found = unit(x[None])
    quiet = 0
    while quiet < QUIET:
        ends, way = found, [links, random_links(structure, rng), random_links(structure, rng), links]
        for start, aim in pairwise(way):
            ends, determined = follow_homotopy(start, aim, ends)
            ends = ends[determined == REACHED]
        more = distinct(np.concatenate([found, ends]))
        quiet = 0 if len(more) > len(found) else quiet + 1
        found = more
    return links, found


def not_linear(structure: Structure, links: ComplexArray, points: ComplexArray, rng: np.random.Generator) -> ComplexArray | None:
    """Return (n,) the trace test's values of the assemblies points (n, 8) of links (6, 7). Their sum is zero for all assemblies together,
    and not for a part of them (Sommese, Verschelde, Wampler, Symmetric functions applied to the decomposition of solution sets, 2002). Five
    links leave a curve of poses, on which one platform point has places y and z = y.y. A sixth link to it from a base point of its own is a
    generic linear form in (y, z): its squared length, changed in equal steps, moves a linear slice in parallel. The sum of y over all
    points of such slices moves in a straight line; were one missing, a loop in the length would exchange it for a present one. The values
    are second differences of a form of y. If no base point has only one link, platform and base are swapped; None if neither body has such
    a point, as in L-222-222. NaN if a path is lost."""
    ends, own = np.array(structure.links).T[::-1], structure.degrees
    if 1 not in own[1]:
        ends, links, points = ends[::-1], links[:, [3, 4, 5, 0, 1, 2, 6]], study_quadric.inverse(points)
    if 1 not in own[0] + own[1]:
        return None
    k = next(i for i, end in enumerate(ends[0]) if (ends[0] == end).sum() == 1)
    way, form = np.zeros_like(links), _complex(rng, 3)
    way[k, 6] = TRACE_STEP * _complex(rng, 1)[0]
    values = []
    for t in (-1.0, 0.0, 1.0):
        ended, determined = follow_homotopy(links, links + t * way, points)
        x = krawczyk.proved(links + t * way, ended).points
        p = study_quadric.product(x[:, 4:], x[:, :4] * [1.0, -1.0, -1.0, -1.0])[:, 1:] / (x[:, :4] ** 2).sum(axis=1)[:, None]
        y = p + study_quadric.turns(x) @ links[k, 3:6]
        values.append(np.where(determined == REACHED, y @ form, np.nan))
    return np.asarray(values[0] - 2.0 * values[1] + values[2])


def distinct(points: ComplexArray) -> ComplexArray:
    """(k, 8) those of points (n, 8) of length one that are no multiples of one before."""
    same = np.abs(points.conj() @ points.T) ** 2 > 1.0 - APART**2
    return points[~np.tril(same, -1).any(axis=1)]


def unit(points: ComplexArray) -> ComplexArray:
    """The points (..., 8) at length one."""
    return np.asarray(points / np.linalg.norm(points, axis=-1, keepdims=True))


def write(kept: Sequence[tuple[ComplexArray, ComplexArray]]) -> None:
    """Write the file of start systems, given in the order of the structures `of_its_own`."""
    counts = np.array([len(points) for _, points in kept])
    links, points = np.array([links for links, _ in kept]), np.concatenate([points for _, points in kept])
    np.savez_compressed(FILE, links=links, counts=counts, points=points)


def _complex(rng: np.random.Generator, *shape: int) -> ComplexArray:
    return np.asarray(rng.normal(size=shape) + 1j * rng.normal(size=shape))
