"""Complex assemblies of every structure by two methods, and the file of start systems.

First by monodromy among platforms of the structure; then by following all assemblies of a general platform, none of whose points are
shared, to a platform of the structure: every isolated assembly of it is an end of one of these paths, however they were found.

    python benchmarks/assembly_counts.py                 # the table
    python benchmarks/assembly_counts.py --write         # and lmeasure/lcoordinate/starts.npz
"""

import argparse
import time

import numpy as np

from lmeasure.arrays import ComplexArray
from lmeasure.kernels.homotopy import REACHED, follow
from lmeasure.lcoordinate import starts
from lmeasure.lcoordinate.structures import Structure

SEED = 20211


def by_degeneration(general: tuple[ComplexArray, ComplexArray], structure: Structure, rng: np.random.Generator) -> int:
    """Assemblies of a platform of the structure that are ends of the paths from those of a general platform."""
    ends, told = follow(general[0], starts.random_links(structure, rng), general[1])
    ends = ends[told == REACHED]
    proper = np.abs((ends[:, :4] ** 2).sum(axis=1)) > 1e-8
    return len(starts.distinct(ends[proper]))


def main() -> None:
    """Print the table, a line as soon as it is known."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write the file of start systems")
    write = parser.parse_args().write
    rng = np.random.default_rng(SEED)
    own = starts.of_its_own()
    began = time.perf_counter()
    kept = {structure: starts.grown(structure, rng) for structure in reversed(own)}
    general = kept[own[-1]]
    print("| structure | monodromy | from the general platform |\n|---|---|---|")
    for structure in own:
        print(f"| {structure.notation} | {len(kept[structure][1])} | {by_degeneration(general, structure, rng)} |", flush=True)
    print(f"{time.perf_counter() - began:.0f} s")
    if write:
        starts.write([kept[s] for s in own])


if __name__ == "__main__":
    main()
