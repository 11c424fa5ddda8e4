"""All assemblies of straight links: closed form in batch against SciPy's iteration, Dietmaier's forty, rigs of every structure, folds.

python benchmarks/straight_assemblies.py --out benchmarks/results/straight_assemblies.md
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "lcoordinate"))

from linkages import DIETMAIER, lengths_at, nearest, rig

from lmeasure import se3
from lmeasure.arrays import FloatArray
from lmeasure.lcoordinate import certified, starts, straight, study
from lmeasure.lcoordinate.structures import Structure, incidence, structures
from lmeasure.lcoordinate.tetrahedra import closed_form

ITERATED, DIETMAIER_RUNS = 40, 20


def in_batch(structure: Structure, count: int) -> str:
    """A row: closed form over many poses, and SciPy's iteration from 0.1 rad and 10 mm beside the true pose."""
    base, platform, poses = rig(structure, 5, count)
    lengths = lengths_at(base, platform, poses)
    began = time.process_time()
    found, closes = closed_form(base, platform, lengths)
    each = (time.process_time() - began) / count
    worst = max(np.abs(lengths_at(base, platform, found[:, k]) - lengths)[closes[:, k]].max() for k in range(found.shape[1]))
    away = np.linalg.norm(found[..., :3] - poses[:, None, :3], axis=-1)
    turned = 100.0 * (1.0 - np.abs((found[..., 3:] * poses[:, None, 3:]).sum(axis=-1)))
    missed = np.where(closes, away + turned, np.inf).min(axis=1)
    began = time.process_time()
    for pose, wanted in zip(poses[:ITERATED], lengths[:ITERATED], strict=True):
        least_squares(
            lambda x, pose=pose, wanted=wanted: lengths_at(base, platform, se3.displaced(pose, x)) - wanted,
            np.repeat([0.1, 10.0], 3),
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
        )
    iteration = (time.process_time() - began) / ITERATED
    figures = f"{1e5 * each:.1f} | {closes.sum() / count:.2f} | {worst:.0e} | {missed.max():.0e} | {iteration / each:.0f}"
    return f"| {structure.notation} | {figures} |"


def second_method(base: FloatArray, platform: FloatArray, lengths: FloatArray) -> FloatArray:
    """Real assemblies followed by another way, through a random platform: (k, 7) poses."""
    size = 256.0
    a, b = base / size, platform / size
    rows = study.links(a, b, (lengths / size) ** 2)
    told = certified.proved(rows, straight._followed(incidence(base, platform), rows, a, b, attempt=7)[0])
    poses = study.poses(told.points[told.real & certified.apart(told)].real)
    poses[:, :3] *= size
    return poses


def rigs_of(structure: Structure, count: int) -> str:
    """A row: rigs with dimensions at random, what was proved of them, and what another way finds besides."""
    proved, missed, true_missed, most, seconds = 0, 0, 0, 0, 0.0
    for seed in range(count):
        base, platform, (pose,) = rig(structure, 1000 + seed)
        lengths = lengths_at(base, platform, pose)
        began = time.process_time()
        found = straight.assemblies(base, platform, lengths)
        seconds += time.process_time() - began
        proved += found.status == straight.ALL
        true_missed += not (len(found.poses) and nearest(found.poses, pose) < 1e-4)
        missed += sum(not (len(found.poses) and nearest(found.poses, other) < 1e-4) for other in second_method(base, platform, lengths))
        most = max(most, len(found.poses))
    n = starts.complex_assemblies(structure)
    assert most <= n
    return f"| {structure.notation} | {n} | {most} | {proved} of {count} | {true_missed} | {missed} | {1e3 * seconds / count:.0f} |"


def at_folds() -> str:
    """How near two assemblies may be: the three columns of 4.5, turned by a small angle either way, with the same lengths."""
    base = np.array([(0, -1, -1.6), (1, 0, -1.6), (0, 1, -1.6), (0, -2.6, 0), (2.6, 0, 0), (0, 2.6, 0)])
    platform = np.array([(0, -1, 0), (1, 0, 0), (0, 1, 0)] * 2, dtype=float)
    told = []
    for angle in 10.0 ** -np.arange(1.0, 9.0):
        lengths = lengths_at(base, platform, se3.pose(np.zeros(3), Rotation.from_rotvec([0.0, 0.0, angle])))
        found = straight.assemblies(base, platform, lengths)
        turn = np.abs(se3.displacement(found.poses, np.array([0.0, 0, 0, 0, 0, 0, 1])))
        near = (turn.max(axis=1) < 5.0 * angle + 1e-4) if len(found.poses) else np.zeros(0, dtype=bool)
        told.append(f"| {angle:.0e} | {near.sum()} | {found.certified[near].sum()} | {found.status} |")
    return "\n".join(["| turn, rad | assemblies there | certified | status |", "|---|---|---|---|", *told])


def main() -> None:
    """Print the page, or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="page to write")
    parser.add_argument("--poses", type=int, default=100_000, help="poses of each structure in closed form")
    parser.add_argument("--rigs", type=int, default=200, help="rigs of each structure")
    asked = parser.parse_args()
    page = ["# Assemblies of straight links", "", "`benchmarks/straight_assemblies.py`; times are those of one processor.", ""]
    page += [
        f"## Closed form, {asked.poses:,} random poses",
        "",
        "| structure | s for 100,000 | assemblies of each | worst length, mm | true pose off, mm | times SciPy |",
    ]
    page += ["|---|---|---|---|---|---|", *(in_batch(s, asked.poses) for s in structures() if s.closed_form and starts.one_of_two(s) == s)]
    spent = []
    for _ in range(DIETMAIER_RUNS):
        began = time.process_time()
        found = straight.assemblies(*DIETMAIER)
        spent.append(time.process_time() - began)
    page += [
        "",
        "## Dietmaier's platform",
        "",
        f"{found.certified.sum()} real assemblies certified of {len(found.poses)}, {found.status}: ",
    ]
    page[-1] += f"{1e3 * np.median(spent):.0f} ms."
    page += ["", f"## {asked.rigs} rigs of every structure with dimensions at random", ""]
    page += ["Missed: poses that the lengths were taken from; real assemblies that another way through a random platform finds.", ""]
    page += [
        "| structure | complex | most real | all accounted for | true poses missed | others missed | ms |",
        "|---|---|---|---|---|---|---|",
    ]
    page += [rigs_of(s, asked.rigs) for s in starts.of_its_own()]
    page += ["", "## Two assemblies that meet", "", at_folds(), ""]
    print("\n".join(page))
    if asked.out:
        asked.out.write_text("\n".join(page), encoding="utf-8")


if __name__ == "__main__":
    main()
