"""All assemblies of straight links: closed form in batch against iteration, Dietmaier's forty, rigs of every structure, folds.

Iteration is that of the program's own kernel at every pose, started beside the true one, and SciPy's at some. On rigs of every structure
two other ways look for assemblies that are missed: the forty of a general platform, followed to the rig, a start system that owes nothing
to the structure's own; and Newton's method from random starts, which knows no homotopy at all.

python benchmarks/straight_assemblies.py --out benchmarks/results/straight_assemblies.md
"""

import sys
import time
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from linkages import DIETMAIER, lengths_at, nearest, rig
from study import options, show

from lmeasure.core import FloatArray, Status, se3
from lmeasure.kernels import ATTACHMENT_XYZ, BASE_XYZ, CABLE_COLUMNS, GUIDE_XYZ, REACHED, follow_homotopy, screw
from lmeasure.linkages import Structure, closed_form, krawczyk, start_systems, straight_links, structures, study_quadric

ITERATED, DIETMAIER_RUNS, NEWTON_STARTS = 40, 20, 500
POSES_TEXT = """Assemblies whose lengths are met to 1e-9 of the rig's size; how far the nearest is from the pose that the
lengths were taken from, and of how many poses farther than 1e-4 mm. Then from 0.1 rad and 10 mm beside the pose: how many the
program's compiled iteration to one assembly solves, how many of its ends are none of the assemblies, and its time. At last how many
times faster all eight assemblies are found than SciPy's iteration finds one."""
RIGS_TEXT = """Missed are assemblies that another way finds and `straight.assemblies` does not: the pose that the lengths were
taken from; those at the ends of paths from a general platform's forty; those that Newton's method finds from 500 random starts. Beside
it which part of the assemblies the other way meets."""
SAME = 1e-4  # mm, and rad times 100: what is nearer is the same assembly


def as_cables(base: FloatArray, platform: FloatArray) -> FloatArray:
    """(6, columns) the links as cables over pulleys of no radius, which the program's iteration takes."""
    rows = np.zeros((6, CABLE_COLUMNS))
    rows[:, BASE_XYZ], rows[:, GUIDE_XYZ], rows[:, ATTACHMENT_XYZ] = base, (0.0, 0.0, 1.0), platform
    return rows


def in_batch(structure: Structure, count: int) -> str:
    """A row: closed form over many poses, and iteration from 0.1 rad and 10 mm beside the true pose."""
    base, platform, poses = rig(structure, 5, count)
    lengths = lengths_at(base, platform, poses)
    closed_form(base, platform, lengths[:10])
    began = time.process_time()
    found, closes = closed_form(base, platform, lengths)
    each = (time.process_time() - began) / count
    worst = max(np.abs(lengths_at(base, platform, found[:, k]) - lengths)[closes[:, k]].max() for k in range(found.shape[1]))
    missed = np.where(closes, off(found, poses), np.inf).min(axis=1)
    rows, beside = as_cables(base, platform), se3.displaced(poses, np.repeat([0.1, 10.0], 3))
    screw.solve_pose(rows, lengths[0], beside[0])
    began = time.process_time()
    solved = [screw.solve_pose(rows, wanted, start) for wanted, start in zip(lengths, beside, strict=True)]
    kernel = (time.process_time() - began) / count
    iterated, met = np.array([one[3] for one in solved]), np.array([one[0] == Status.OK for one in solved])
    lost = int((np.where(closes, off(found, iterated), np.inf).min(axis=1)[met] > SAME).sum())
    began = time.process_time()
    for pose, wanted in zip(poses[:ITERATED], lengths[:ITERATED], strict=True):
        least_squares(
            lambda x, pose=pose, wanted=wanted: lengths_at(base, platform, se3.displaced(pose, x)) - wanted,
            np.repeat([0.1, 10.0], 3),
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
        )
    scipy = (time.process_time() - began) / ITERATED
    figures = f"{1e5 * each:.1f} | {closes.sum() / count:.2f} | {worst:.0e} | {missed.max():.0e} | {(missed > SAME).sum()} "
    return f"| {structure.notation} | {figures}| {met.sum()} | {lost} | {1e6 * kernel:.0f} | {scipy / each:.0f} |"


def off(found: FloatArray, poses: FloatArray) -> FloatArray:
    """(n, k) how far found poses (n, k, 7) are from poses (n, 7) [mm, a radian counting as 100]."""
    away = np.linalg.norm(found[..., :3] - poses[:, None, :3], axis=-1)
    q, p = found[..., 3:], poses[:, None, 3:]
    return away + 200.0 * np.minimum(np.linalg.norm(q - p, axis=-1), np.linalg.norm(q + p, axis=-1))


def from_the_general_platform(base: FloatArray, platform: FloatArray, lengths: FloatArray) -> FloatArray:
    """Real assemblies at the ends of the paths from a general platform's forty: (k, 7) poses."""
    at, of, size = base.mean(axis=0), platform.mean(axis=0), 256.0
    rows = study_quadric.links((base - at) / size, (platform - of) / size, (lengths / size) ** 2)
    general, forty = start_systems.start_of(start_systems.of_its_own()[-1])
    between = start_systems.random_links(start_systems.of_its_own()[-1], np.random.default_rng(77))
    forty, reported = follow_homotopy(general, between, forty)
    ends = follow_homotopy(between, rows, forty[reported == REACHED])[0]
    proofs = krawczyk.proved(rows, ends)
    poses = study_quadric.poses(proofs.points[proofs.real & krawczyk.apart(proofs)].real)
    poses[:, :3] = poses[:, :3] * size + at - (se3.matrices(poses) @ of if len(poses) else 0.0)
    return poses


def by_newton(base: FloatArray, platform: FloatArray, lengths: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Real assemblies that Newton's method meets from random starts: (k, 7) poses, some of them several times."""
    middle, reach = base.mean(axis=0), lengths.max() + np.ptp(platform, axis=0).max()
    starting = se3.pose(middle + reach * rng.uniform(-1.0, 1.0, (NEWTON_STARTS, 3)), Rotation.random(NEWTON_STARTS, rng=rng))
    status, poses = screw.solve_poses(as_cables(base, platform), lengths, starting)
    return poses[status == Status.OK]


def missed_of(found: FloatArray, others: FloatArray) -> int:
    """How many of the other poses are none of those found."""
    return sum(not (len(found) and nearest(found, other) < SAME) for other in others)


def rigs_of(structure: Structure, count: int) -> str:
    """A row: rigs with dimensions at random, what was proved of them, and what the two other ways find besides."""
    straight_links.assemblies(*DIETMAIER)
    proved, missed, met, true_missed, most, real, seconds = 0, np.zeros(2, int), np.zeros(2, int), 0, 0, 0, 0.0
    for seed in range(count):
        base, platform, (pose,) = rig(structure, 1000 + seed)
        lengths = lengths_at(base, platform, pose)
        began = time.process_time()
        found = straight_links.assemblies(base, platform, lengths)
        seconds += time.process_time() - began
        proved += found.status == straight_links.ALL
        true_missed += missed_of(found.poses, pose[None])
        followed = from_the_general_platform(base, platform, lengths)
        iterated = by_newton(base, platform, lengths, np.random.default_rng(seed))
        missed += [missed_of(found.poses, followed), missed_of(found.poses, iterated)]
        met += [len(found.poses) - missed_of(others, found.poses) for others in (followed, iterated)]
        most = max(most, len(found.poses))
        real += len(found.poses)
    n = start_systems.complex_assemblies(structure)
    assert most <= n
    others = f"{missed[0]} | {100.0 * met[0] / real:.1f} % | {missed[1]} | {100.0 * met[1] / real:.1f} %"
    return (
        f"| {structure.notation} | {n} | {most} | {real} | {proved} of {count} | {true_missed} | {others} | {1e3 * seconds / count:.0f} |"
    )


def at_folds() -> str:
    """How near two assemblies may be: the three columns of 4.5, turned by a small angle either way, with the same lengths."""
    base = np.array([(0, -1, -1.6), (1, 0, -1.6), (0, 1, -1.6), (0, -2.6, 0), (2.6, 0, 0), (0, 2.6, 0)])
    platform = np.array([(0, -1, 0), (1, 0, 0), (0, 1, 0)] * 2, dtype=float)
    reported = []
    for angle in 10.0 ** -np.arange(1.0, 9.0):
        lengths = lengths_at(base, platform, se3.pose(np.zeros(3), Rotation.from_rotvec([0.0, 0.0, angle])))
        found = straight_links.assemblies(base, platform, lengths)
        turn = np.abs(se3.displacement(found.poses, np.array([0.0, 0, 0, 0, 0, 0, 1])))
        near = (turn.max(axis=1) < 5.0 * angle + 1e-4) if len(found.poses) else np.zeros(0, dtype=bool)
        reported.append(f"| {angle:.0e} | {near.sum()} | {found.certified[near].sum()} | {found.status} |")
    return "\n".join(["| turn, rad | assemblies there | certified | status |", "|---|---|---|---|", *reported])


def main() -> None:
    """Print the page, or write it."""
    parser = options(__doc__)
    parser.add_argument("--poses", type=int, default=100_000, help="poses of each structure in closed form")
    parser.add_argument("--rigs", type=int, default=200, help="rigs of each structure")
    arguments = parser.parse_args()
    page = ["# Assemblies of straight links", "", "`benchmarks/straight_assemblies.py`; times are those of one processor.", ""]
    page += [f"## Closed form, {arguments.poses:,} random poses", "", POSES_TEXT, ""]
    page += [
        "| structure | s for 100,000 | assemblies of each | worst length, mm | true pose off, mm | beyond 1e-4 | iterated | ends missed "
    ]
    page[-1] += "| us of the kernel | times SciPy |"
    page += ["|---" * 10 + "|", *(in_batch(s, arguments.poses) for s in structures() if s.closed_form)]
    spent = []
    for _ in range(DIETMAIER_RUNS):
        began = time.process_time()
        found = straight_links.assemblies(*DIETMAIER)
        spent.append(time.process_time() - began)
    page += [
        "",
        "## Dietmaier's platform",
        "",
        f"{found.certified.sum()} real assemblies certified of {len(found.poses)}, {found.status}: ",
    ]
    page[-1] += f"{1e3 * np.median(spent):.0f} ms."
    page += ["", f"## {arguments.rigs} rigs of every structure with dimensions at random", "", RIGS_TEXT, ""]
    page += [
        "| structure | complex | most real | real in all | all accounted for | true poses missed | general: missed | met "
        "| Newton: missed | met | ms |"
    ]
    page += ["|---" * 11 + "|", *(rigs_of(s, arguments.rigs) for s in structures() if s.degenerate is None)]
    page += ["", "## Two assemblies that meet", "", at_folds(), ""]
    show(arguments, "\n".join(page), "straight_assemblies")


if __name__ == "__main__":
    main()
