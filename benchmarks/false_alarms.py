"""Sound runs of six drums with six swivel encoders, and of eight drums: how often rounding alone would be taken for a contradiction.

    python benchmarks/false_alarms.py [--cells 400] [--write]

Each cell is one of `single_faults`: a rig, a motion of 4 s at 250 Hz, phases of its counters, all known exactly but these. Chi-squared of
every sample is held against the limits of the normal law (chi-squared of as many degrees of freedom as there are channels to spare) and of
rounding (`trajectory.faults.redundancy`), and the largest of a run against the limits that a run is to pass once in so many.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.stats import binom, chi2
from single_faults import RIGS, TIME_S, Cell

RESULTS = Path(__file__).parent / "results" / "false_alarms.md"
SAMPLES = (1e-2, 1e-3, 1e-4, 1e-5)
RUNS = (0.5, 0.1, 0.01)


def study(name: str, cells: int) -> str:
    """The table of a rig."""
    of_samples, of_runs, limits = np.zeros((2, len(SAMPLES))), np.zeros((2, len(RUNS))), np.zeros((2, cells))
    for number in range(cells):
        at = Cell(name, number)
        m = len(at.per_count)
        chi = at.redundancy.parities(at.epochs, at.poses).chi_squared
        rounded = at.redundancy.chance(at.epochs, at.poses, np.ones(m, np.bool_))
        for k, limit in enumerate((chi2(m - 6).isf, rounded.limit)):
            of_samples[k] += [(chi > limit(chance)).sum() for chance in SAMPLES]
            of_runs[k] += [chi.max() > limit(chance / len(TIME_S)) for chance in RUNS]
            limits[k, number] = limit(1e-3 / len(TIME_S))
    n, (normal, own) = cells * len(TIME_S), limits.mean(axis=1)
    lines = [f"## {name}: {cells} runs of {len(TIME_S)} samples", "", "| of | stated | normal law | rounding | consistent up to |"]
    lines.append("|---|---|---|---|---|")
    for k, chance in enumerate(SAMPLES):
        lines.append(f"| samples | {chance:g} | {of_samples[0, k] / n:.2g} | {of_samples[1, k] / n:.2g} | |")
    for k, chance in enumerate(RUNS):
        high = int(binom.ppf(0.99, cells, chance))
        lines.append(f"| runs | {chance:g} | {of_runs[0, k] / cells:.3g} | {of_runs[1, k] / cells:.3g} | {high / cells:.3g} |")
    lines += [
        "",
        f"An alarm of a run (once in a thousand) begins at chi-squared {own:.1f} in the mean, by the normal law at {normal:.1f}: ",
    ]
    lines[-1] += f"a fault is seen from {np.sqrt(own / normal):.2f} times the size on."
    return "\n".join([*lines, ""])


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=400)
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    about = (__doc__ or "").split("\n\n", 2)
    text = "\n".join(["# Alarms of sound runs", "", about[0], "", about[2].strip(), "", *(study(name, asked.cells) for name in RIGS)])
    print(text)
    if asked.write:
        RESULTS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
