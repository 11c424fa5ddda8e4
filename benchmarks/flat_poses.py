"""Drives that lead out of flat poses or jam, beside brute force: each length alone changed both ways, at singular poses of random rigs.

    python benchmarks/flat_poses.py [--poses 1000] [--write]

A pose with the changed lengths is looked for by Levenberg's steps of its own from points of the lost twist on both sides, with no formula
of the program. A sign is right where such poses exist on the side that it names and none on the other. Near a cusp the curvature's parts
cancel, and other assemblies are so near that brute force finds them; the program gives no signs there, and such poses are counted apart.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from study import options, show, table

from lmeasure.core import StructureError
from lmeasure.linkages import leading_out, lost_twists, nearest_singular

FloatArray = NDArray[np.float64]
CHANGE = 1e-5
"""Of the body's size: what each length changes by."""
STEPS = 60


def drawn(seed: int) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Base and body (6, 3) of a random structure, and the singular pose (7,) nearest to a random one."""
    rng = np.random.default_rng(seed)
    shared = [np.arange(6), np.array([0, 0, 1, 1, 2, 2]), np.array([0, 1, 1, 2, 2, 0])][seed % 3]
    base, body = rng.normal(size=(6, 3)) * 5.0, rng.normal(size=(6, 3))[shared] * 1.5
    pose = np.r_[rng.normal(size=3) * 2.0 + [0, 0, 5.0], Rotation.random(random_state=seed).as_quat()]
    try:
        return base, body, nearest_singular(base, body, pose)
    except StructureError:
        return None


def misses(base: FloatArray, body: FloatArray, starts: FloatArray, aims: FloatArray) -> FloatArray:
    """(k,) by how much lengths miss the aims (k, 6) at the poses found from starts (k, 7)."""
    turns, places = Rotation.from_quat(starts[:, 3:]).as_matrix(), starts[:, :3].copy()
    damping = np.full(len(starts), 1e-3)

    def lacks(turns: FloatArray, places: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        arms = np.einsum("kij,mj->kmi", turns, body)
        spans = places[:, None] + arms - base
        far = np.linalg.norm(spans, axis=-1)
        return far - aims, spans / far[..., None], arms

    off, e, arms = lacks(turns, places)
    for _ in range(STEPS):
        J = np.concatenate([np.cross(arms, e), e], axis=-1)
        square = np.einsum("kmi,kmj->kij", J, J) + damping[:, None, None] * np.eye(6)
        step = -np.linalg.solve(square, np.einsum("kmi,km->ki", J, off)[..., None])[..., 0]
        new = Rotation.from_rotvec(step[:, :3]).as_matrix() @ turns, places + step[:, 3:]
        there = lacks(*new)
        good = (there[0] ** 2).sum(axis=1) < (off**2).sum(axis=1)
        turns[good], places[good], off[good], e[good], arms[good] = (
            new[0][good],
            new[1][good],
            there[0][good],
            there[1][good],
            there[2][good],
        )
        damping = np.where(good, 0.2 * damping, 5.0 * damping)
    return np.abs(off).max(axis=1)


def right(seed: int) -> tuple[int, int] | None:
    """How many drives of a flat pose have a sign, and for how many brute force says the same; None where there is no such pose."""
    rig = drawn(seed)
    if rig is None:
        return None
    signs = leading_out(*rig)
    if signs is None:
        return 0, 0
    base, body, pose = rig
    (twist,) = lost_twists(base, body, pose)
    turn, at = Rotation.from_quat(pose[3:]), pose[:3]
    lengths = np.linalg.norm(at + turn.apply(body) - base, axis=1)
    size = float(np.linalg.norm(body, axis=1).max())
    part = twist[3:] + np.cross(twist[:3], at)
    unit = 1.0 / max(float(np.linalg.norm(twist[:3])), float(np.linalg.norm(part)) / size)
    sides = [s * unit * (CHANGE**0.5) for s in (-3.0, -1.0, 1.0, 3.0)]
    starts = np.array([np.r_[at + s * part, (Rotation.from_rotvec(s * twist[:3]) * turn).as_quat()] for s in sides])

    same = 0
    for i in np.flatnonzero(signs):
        reached = []
        for way in (1.0, -1.0):
            aims = np.tile(lengths + way * CHANGE * size * np.eye(6)[i], (len(starts), 1))
            reached.append(bool(misses(base, body, starts, aims).min() < 1e-4 * CHANGE * size))
        same += reached == [signs[i] > 0, signs[i] < 0]
    return int(np.count_nonzero(signs)), same


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--poses", type=int, default=1000)
    arguments = parser.parse_args()
    found: list[tuple[int, int]] = []
    seed = 0
    while len(found) < arguments.poses:
        one = right(seed)
        seed += 1
        if one is not None:
            found.append(one)
    rows = []
    for name, signed in (("elsewhere", True), ("near a cusp", False)):
        of = [one for one in found if (one[0] > 0) == signed]
        rows.append((name, len(of), *(sum(part) for part in zip(*of, strict=True))) if of else (name, 0, 0, 0))
    head = ("flat poses", "number", "drives with a sign", "the same by brute force")
    run = f"`python benchmarks/flat_poses.py --poses {arguments.poses} --write`, seeds 0 to {seed - 1}."
    text = f"# Drives that lead out of flat poses beside brute force\n\n{run}\n\n{table(head, rows)}\n"
    show(arguments, text, "flat_poses")


if __name__ == "__main__":
    main()
