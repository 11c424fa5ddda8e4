"""Wrong starts on random rigs: is a wrong assembly ever called right?

    python benchmarks/robustness.py [--poses 1000000] [--seed 1] [--write]

Random rigs of six cables with pulleys; at each pose whose worst pressure angle is at most 75 degrees the screw method is started up to
50 mm and 0.2 rad off and follows the lengths from those of the start to the measured ones, as behind a gap. A found pose is called right
when its status is `ok` and its worst pressure angle and that of the start are within 75 degrees, as on a rig that nowhere has more: a wrong
start nearer to a singular pose may lie on the other side of it, and the program says so of such a start, or refuses it where its stated
uncertainty reaches so far. It is wrong when it is another pose than the true one.
--write keeps the result in results/robustness.md.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from study import options, show

from lmeasure.core import Status
from lmeasure.kernels import CABLE_COLUMNS, screw, span_lengths
from lmeasure.kernels.cable import span_at
from lmeasure.kernels.decorators import kernel

FloatArray = NDArray[np.float64]

LIMIT_RAD = math.radians(75.0)
OFF_MM, OFF_RAD = 50.0, 0.2
POSES_PER_RIG = 200
U_MM = np.full(6, 0.012 / math.sqrt(12.0))


@kernel
def outcomes(cables: FloatArray, poses: FloatArray, starts: FloatArray, lengths: FloatArray, u: FloatArray) -> NDArray[np.int64]:
    """For each pose: 0 right, 1 refused, 2 wrong but called right, 3 not asked (the pose itself is beyond the limit)."""
    out = np.empty(len(poses), np.int64)
    J, inverse = np.empty((6, 6)), np.empty((6, 6))
    size = screw.platform_size(cables)
    for i in range(len(poses)):
        if (
            screw.invert(cables, poses[i], J, inverse, size) == 0.0
            or not screw.worst_pressure_angle(cables, poses[i], inverse) <= LIMIT_RAD
        ):
            out[i] = 3
            continue
        screw.invert(cables, starts[i], J, inverse, size)
        start_angle = screw.worst_pressure_angle(cables, starts[i], inverse)
        change, flag = np.empty((1, 6)), np.zeros(1, np.int64)
        for j in range(6):
            change[0, j] = lengths[i, j] - span_at(cables[j], starts[i])[0]
        path, _, _, status, angle = screw.track(cables, starts[i], change, flag, u)
        if status[0] != Status.OK or not angle[0] <= LIMIT_RAD or not start_angle <= LIMIT_RAD:
            out[i] = 1
            continue
        found = path[0]
        distance = 0.0
        for c in range(3):
            distance = max(distance, abs(found[c] - poses[i, c]))
        out[i] = 0 if distance < 1e-6 else 2
    return out


def random_rig(generator: np.random.Generator) -> FloatArray:
    """(6, columns) cables: points 0.8 to 2 m away in random directions, three to six attachment points on a body of 100 to 250 mm."""
    rows = np.zeros((6, CABLE_COLUMNS))
    direction = generator.normal(size=(6, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    rows[:, 0:3] = direction * generator.uniform(800, 2000, (6, 1))
    u = -direction + generator.normal(0.0, 0.2, (6, 3))
    rows[:, 3:6] = u / np.linalg.norm(u, axis=1)[:, None]
    rows[:, 6] = generator.uniform(0, 30, 6)
    points = generator.normal(size=(int(generator.integers(3, 7)), 3))
    points *= generator.uniform(100, 250, (len(points), 1)) / np.linalg.norm(points, axis=1)[:, None]
    rows[:, 7:10] = points[np.arange(6) % len(points)]
    return rows


def random_poses(generator: np.random.Generator, n: int, reach_mm: float, tilt_rad: float) -> FloatArray:
    """(n, 7) poses within a cube and tilts."""
    return np.column_stack(
        [generator.uniform(-reach_mm, reach_mm, (n, 3)), Rotation.from_rotvec(generator.uniform(-tilt_rad, tilt_rad, (n, 3))).as_quat()]
    )


def off(generator: np.random.Generator, poses: FloatArray) -> FloatArray:
    """(n, 7) the poses displaced by up to OFF_MM and turned by up to OFF_RAD, in random directions."""
    shift, axis = generator.normal(size=(2, len(poses), 3))
    shift *= generator.uniform(0, OFF_MM, (len(poses), 1)) / np.linalg.norm(shift, axis=1)[:, None]
    axis *= generator.uniform(0, OFF_RAD, (len(poses), 1)) / np.linalg.norm(axis, axis=1)[:, None]
    turned = Rotation.from_rotvec(axis) * Rotation.from_quat(poses[:, 3:])
    return np.column_stack([poses[:, :3] + shift, turned.as_quat()])


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--poses", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    generator = np.random.default_rng(arguments.seed)
    counts, rigs = np.zeros(4, np.int64), 0
    while counts[:3].sum() < arguments.poses:
        rows = random_rig(generator)
        poses = random_poses(generator, POSES_PER_RIG, 300.0, 0.3)
        lengths = span_lengths(rows, poses)
        good = np.isfinite(lengths).all(axis=1)
        result = outcomes(rows, poses[good], off(generator, poses[good]), lengths[good], U_MM)
        counts += np.bincount(result, minlength=4)
        rigs += 1
    asked = counts[:3].sum()
    text = "\n".join(
        [
            "# Robustness against a wrong start",
            "",
            f"{asked:,} poses with a worst pressure angle of at most 75 degrees on {rigs:,} random rigs, seed {arguments.seed}; starts",
            f"up to {OFF_MM:g} mm and {OFF_RAD:g} rad off, the lengths followed from those of the start.",
            "Refused: not `ok`, or the start itself beyond 75 degrees.",
            "",
            "| outcome | poses |",
            "|---|---|",
            f"| the true pose | {counts[0]:,} |",
            f"| refused | {counts[1]:,} |",
            f"| another assembly called right | {counts[2]:,} |",
            "",
        ]
    )
    show(arguments, text, "robustness")


if __name__ == "__main__":
    main()
