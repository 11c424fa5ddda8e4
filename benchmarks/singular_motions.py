"""Motions past singular poses: the error of the whole pose beside that of the part which lengths determine (thesis, conclusion).

    python benchmarks/singular_motions.py [--rigs 200] [--write]

A random hexapod goes evenly on a straight line through the singular pose nearest to a random one, turning. Each length errs by 0.01 mm at
every pose by itself. Poses are solved by Newton's method of its own from the true ones. An error is split by `structure.parts`' screw; in
the last column the part along the screw is bridged: interpolated in time between the poses where lengths see it better than 1 to 30.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from study import options, show, table

from lmeasure.core import StructureError, se3
from lmeasure.linkages import nearest_singular
from lmeasure.structure import Linkage, parts

FloatArray = NDArray[np.float64]
U_MM = 0.01
POSES = 121
WAY_MM, TURN_RAD = 150.0, 0.3
WELL = 30.0
BANDS = ((0.0, 10.0), (10.0, 30.0), (30.0, 100.0), (100.0, 1e4))


def errors(seed: int) -> FloatArray | None:
    """(n, 4) of a motion: mm of the rim by 1 mm of length, errors of the whole pose, of the determined part, and bridged [mm]; None where a
    rig has no singular pose or its poses are lost."""
    rng = np.random.default_rng(seed)
    base, body = rng.normal(size=(6, 3)) * 500.0, rng.normal(size=(6, 3)) * 150.0
    begin = np.r_[rng.normal(size=3) * 100.0 + [0, 0, 500.0], Rotation.random(random_state=seed).as_quat()]
    try:
        middle = nearest_singular(base, body, begin)
    except StructureError:
        return None
    way, turn = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    share = np.linspace(-0.5, 0.5, POSES)[:, None]
    true = se3.displaced(middle, share * np.r_[TURN_RAD * turn, WAY_MM * way])
    rim = float(np.linalg.norm(body - body.mean(axis=0), axis=1).max())
    unit = np.repeat([1.0 / rim, 1.0], 3)
    linkage = Linkage(base, body, [(str(i), str(i), str(i)) for i in range(6)])
    own = parts(linkage, true)
    screws = own.twists / unit
    noise = rng.normal(size=(POSES, 6)) * U_MM
    found = np.full((POSES, 6), np.nan)
    for i, pose in enumerate(true):
        aim = np.linalg.norm(se3.apply(pose, body) - base, axis=1) + noise[i]
        now = pose
        for _ in range(30):
            arms = se3.apply(now, body) - now[:3]
            span = now[:3] + arms - base
            far = np.linalg.norm(span, axis=1)
            e = span / far[:, None]
            step = np.linalg.lstsq(np.hstack([np.cross(arms, e), e]) * unit, aim - far, rcond=None)[0]
            if not np.abs(step).max() < 200.0:
                break
            now = se3.displaced(now, step * unit)
            if np.abs(step).max() < 1e-9:
                found[i] = se3.displacement(now[None], pose)[0] / unit
                break
    along = (found * screws).sum(axis=1)
    rest = np.linalg.norm(found - along[:, None] * screws, axis=1)
    seen = (own.reciprocal_mm_per_mm < WELL) & np.isfinite(along)
    if seen.sum() < 2:
        return None
    at = np.arange(POSES, dtype=float)
    # the true motion is even: what is bridged errs by what its ends err
    bridged = np.hypot(rest, np.where(seen, along, np.interp(at, at[seen], along[seen])))
    return np.column_stack([own.reciprocal_mm_per_mm, np.linalg.norm(found, axis=1), rest, bridged])


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--rigs", type=int, default=200)
    arguments = parser.parse_args()
    every = np.concatenate([one for one in map(errors, range(arguments.rigs)) if one is not None])
    rows = []
    for low, high in BANDS:
        of = every[(every[:, 0] >= low) & (every[:, 0] < high)]
        lost = np.isnan(of[:, 1])
        middle = [f"{v:.3f}" for v in np.median(of[~lost, 1:], axis=0)]
        most = [f"{v:.3f}" for v in np.percentile(of[~lost, 1:], 95.0, axis=0)]
        rows.append((f"{low:g} to {high:g}", len(of), int(lost.sum()), *(f"{a} / {b}" for a, b in zip(middle, most, strict=True))))
    head = ("mm of the rim per mm of length", "poses", "without a pose", "whole pose", "part that lengths determine", "bridged")
    run = f"`python benchmarks/singular_motions.py --rigs {arguments.rigs} --write`, seeds 0 to {arguments.rigs - 1}, lengths of {U_MM} mm."
    text = f"# Motions past singular poses\n\n{run} Errors in mm, a turn counted at the rim: median / 95 of 100.\n\n{table(head, rows)}\n"
    show(arguments, text, "singular_motions")


if __name__ == "__main__":
    main()
