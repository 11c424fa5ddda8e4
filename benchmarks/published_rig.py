"""What the four poses that thesis Rashoyan 2021 publishes (5.5) can say of its three observation points, and what they cannot.

    python benchmarks/published_rig.py [--write]

Coarse: roots of the thesis' 5.6 to 5.8, straight cables to the point P1 of the flange. Fine: guides, pulley and drum are drawn from all
they may be, and for each draw the place of B is solved for whose lengths, wrap and drum included, are those counted: three equations and
unknowns. docs/published-rig.md prints these tables, and a test holds them against the page.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import qmc
from study import options, show

from lmeasure.calibration.solve.points import coarse_solutions
from lmeasure.core import rotation_from_angles
from lmeasure.kernels import CABLE_COLUMNS
from lmeasure.sensors import span_rows

FloatArray = NDArray[np.float64]

DATA = Path(__file__).parents[1] / "datasets" / "thesis-5.5"
COUNT_MM, COUNTS_PER_TURN = 0.012, 6000
CHANNELS = (("K1", 1.0), ("K2", 1.0), ("K3", 1.0), ("K3, counts doubled", 2.0))
DRAWN = 1024
LEAST = np.array([-np.pi / 2.0, 0.0, 0.0, 0.0, 50.0, 0.0])
MOST = np.array([np.pi / 2.0, 2.0 * np.pi, 60.0, 3.0, 300.0, 60.0])
"""Of the guide angles [rad], pulley radius, groove pitch, tangent length and axial offset [mm] that are drawn."""
FITS_MM = 1e-6
ROUNDS, LONGEST_STEP_MM = 80, 100.0


def columns(name: str, first: int, last: int) -> FloatArray:
    """Numbers of a file of the data set."""
    return np.loadtxt(DATA / name, delimiter=",", skiprows=1, usecols=range(first, last))


def published() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Poses (4, 7), counts (4, 3), the attachment point P1 (3,), and the thesis' refined and coarse points (3, 3) each."""
    table, points = columns("reference_poses.csv", 1, 7), columns("published_points.csv", 1, 7)
    poses = np.column_stack([table[:, :3], rotation_from_angles("puma-oat", table[:, [4, 3, 5]]).as_quat()])
    return poses, columns("counts.csv", 1, 4), columns("attachment_points.csv", 1, 4)[0], points[:, 3:], points[:, :3]


def places(poses: FloatArray, counts: FloatArray, attachment: FloatArray, sets: FloatArray, begin: FloatArray) -> FloatArray:
    """(q, 3) places of B whose cable lengths are the counts' (4,), for sets (q, 6) of all else in the order of LEAST; NaN where none is
    found."""
    a, b, radius, pitch, tangent, offset = sets.T
    cables = np.zeros((len(sets), CABLE_COLUMNS))
    cables[:, 3:6] = np.column_stack([-np.cos(a) * np.sin(b), -np.cos(a) * np.cos(b), np.sin(a)])
    cables[:, 6], cables[:, 7:10] = radius, attachment
    at_drum = np.hypot(tangent, offset + counts[:, None] * pitch / COUNTS_PER_TURN)
    wanted = (counts[:, None] * COUNT_MM - (at_drum - at_drum[0]))[1:]
    place = np.tile(begin, (len(sets), 1))
    for _ in range(ROUNDS):
        cables[:, :3] = place
        lengths, rows = span_rows(cables, poses)
        missing = wanted - (lengths - lengths[0])[1:]
        known = np.isfinite(missing).all(axis=0)
        # a cable grows as B goes against its direction
        J = -np.moveaxis((rows[1:, :, 3:] - rows[:1, :, 3:]), 1, 0)[known]
        step = np.linalg.solve(J, missing.T[known, :, None])[:, :, 0]
        place[known] += step * np.minimum(1.0, LONGEST_STEP_MM / np.linalg.norm(step, axis=1))[:, None]
    place[~(np.abs(missing).max(axis=0) < FITS_MM)] = np.nan
    return place


def coarse_table() -> list[str]:
    """Lines of the table of coarse places."""
    poses, counts, attachment, refined, coarse = published()
    at = poses[:, :3] + Rotation.from_quat(poses[:, 3:]).apply(attachment)
    out = ["| channel | observation point, mm | cable at pose 1, mm | from the refined point, mm | from the coarse one, mm |"]
    out.append("|---|---|---|---|---|")
    for name, factor in CHANNELS:
        k = int(name[1]) - 1
        root = coarse_solutions(at, factor * counts[:, k] * COUNT_MM, 0, refined[k])[0]
        x, y, z = root.position
        far = [np.linalg.norm(root.position - p[k]) for p in (refined, coarse)]
        out.append(f"| {name} | {x:.3f}, {y:.3f}, {z:.3f} | {root.first_length:.3f} | {far[0]:.1f} | {far[1]:.1f} |")
    return out


def fine_table() -> list[str]:
    """Lines of the table of all places that fit."""
    poses, counts, attachment, refined, _ = published()
    drawn = LEAST + qmc.Sobol(6, seed=0).random(DRAWN) * (MOST - LEAST)
    out = [
        "| point | x, mm | y, mm | z, mm | draws that fit | published (refined) | nearest that fits, mm away |",
        "|---|---|---|---|---|---|---|",
    ]
    for k, factor in enumerate((1.0, 1.0, 2.0)):
        found = places(poses, factor * counts[:, k], attachment, drawn, refined[k])
        fits = ~np.isnan(found[:, 0])
        low, high = found[fits].min(axis=0), found[fits].max(axis=0)
        ranges = " | ".join(f"{a:.0f} to {b:.0f}" for a, b in zip(low, high, strict=True))
        near = np.linalg.norm(found[fits] - refined[k], axis=1).min()
        x, y, z = refined[k]
        out.append(f"| B{k + 1} | {ranges} | {100.0 * fits.mean():.1f} % | {x:.2f}, {y:.1f}, {z:.2f} | {near:.0f} |")
    return out


def main() -> None:
    """Print the tables, or write them."""
    parser = options(__doc__)
    lines = [
        "# What four published poses say of three observation points",
        "",
        "`python benchmarks/published_rig.py --write`. Straight cables to P1, thesis 5.6 to 5.8:",
        "",
        *coarse_table(),
        "",
        f"Places of B that fit the counts exactly, K3 doubled, for {DRAWN} draws (Sobol) of guides in any direction, pulleys of 0 to "
        "60 mm, groove pitches of 0 to 3 mm, 50 to 300 mm from drum to fixed pulley and axial offsets of 0 to 60 mm:",
        "",
        *fine_table(),
    ]
    show(parser.parse_args(), "\n".join(lines), "published_rig")


if __name__ == "__main__":
    main()
