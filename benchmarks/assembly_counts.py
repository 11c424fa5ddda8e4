"""Complex assemblies of every structure by three methods, and the file of start systems.

First by monodromy among platforms of the structure, those of the file and others; then by following all assemblies of a general platform,
none of whose points are shared, to a platform of the structure: every isolated assembly of it is an end of one of these paths, however
they were found. At last the trace test, which asks of what was found whether anything is missing: second differences of the sum over all,
and the least of those over all but one, as parts of the largest of one assembly (`starts.not_linear`).

    python benchmarks/assembly_counts.py [--write] [--systems]    # --systems: write lmeasure/linkages/start_systems.npz too
"""

import time

import numpy as np
from study import options, show, table

from lmeasure.core import ComplexArray
from lmeasure.kernels import REACHED, follow_homotopy
from lmeasure.linkages import Structure, start_systems

SEED = 20211


def by_degeneration(general: tuple[ComplexArray, ComplexArray], structure: Structure, rng: np.random.Generator) -> int:
    """Assemblies of a platform of the structure that are ends of the paths from those of a general platform."""
    ends, reported = follow_homotopy(general[0], start_systems.random_links(structure, rng), general[1])
    ends = ends[reported == REACHED]
    proper = np.abs((ends[:, :4] ** 2).sum(axis=1)) > 1e-8
    return len(start_systems.distinct(ends[proper]))


def trace(structure: Structure, start: tuple[ComplexArray, ComplexArray], rng: np.random.Generator) -> tuple[str, str]:
    """Two columns: of all assemblies, and the least of all but one."""
    off = start_systems.not_linear(structure, *start, rng)
    if off is None:
        return "no point of one link", ""
    size = np.abs(off).max()
    return f"{abs(off.sum()) / size:.0e}", f"{np.abs(off.sum() - off).min() / size:.0e}"


def main() -> None:
    """Print the table, a line as soon as it is known."""
    parser = options(__doc__)
    parser.add_argument("--systems", action="store_true", help="write the file of start systems")
    arguments = parser.parse_args()
    rng = np.random.default_rng(SEED)
    own = start_systems.of_its_own()
    began = time.process_time()
    if arguments.systems:
        start_systems.write([start_systems.grown(structure, rng) for structure in reversed(own)][::-1])
    general = start_systems.start_of(own[-1])
    rows = []
    for structure in own:
        kept = start_systems.start_of(structure)
        counts = (len(kept[1]), len(start_systems.grown(structure, rng)[1]), by_degeneration(general, structure, rng))
        rows.append([structure.notation, *counts, *trace(structure, kept, rng)])
        print(*rows[-1], flush=True)
    seconds = time.process_time() - began
    head = ["structure", "of the file", "monodromy", "from the general platform", "trace of all", "of all but one"]
    about = f"{seconds:.0f} s. Of L-222-222 every assembly is an end of one of the sixteen of L-222-2211:ab-ac-bd."
    title = "# Complex assemblies of every structure\n\n`benchmarks/assembly_counts.py`"
    show(arguments, f"{title}\n\n{table(head, rows)}\n\n{about}", "assembly_counts")


if __name__ == "__main__":
    main()
