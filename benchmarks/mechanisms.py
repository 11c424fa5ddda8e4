"""Forward problems of the documents' mechanisms, side by side with what a user would write: SciPy's root finder on the distances.

    python benchmarks/mechanisms.py [--write]

Each built-in robot finds random poses again from their drives, twice: by Newton's method from home, as SciPy does, and along the way there
from home, as `identify` and `simulate` do, which no other assembly can be taken for.
"""

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import root
from scipy.spatial.transform import Rotation
from study import options, show, table

from lmeasure.core import BoolArray, FloatArray, se3
from lmeasure.robots import any_shipped, checked
from lmeasure.robots.parallel.limits import own_roots, ranges
from lmeasure.robots.parallel.model import EQUATIONS, Parallel

POSES, SLOW, ROUNDS = 5000, 60, 3
PART, REACH_RAD = 0.05, 0.3
ROBOTS = ("rotopod", "four-chains", "four-chains-arms", "crank-platform", "logos", "seven-link", "three-prr")


def generic_robot(robot: Parallel, drives: FloatArray) -> FloatArray:
    """One pose after the other from the six equations by rotation vector and position, derivatives by differences."""
    points = np.array([robot.legs[i].point for i in robot.owners])
    turn0, at0 = se3.rotation(robot.home).as_rotvec(), robot.home[:3]
    size = robot.size_mm
    parts = np.split(drives, np.cumsum([len(leg.of.drives) for leg in robot.legs])[:-1], axis=1)
    equations = [e for leg, own in zip(robot.legs, parts, strict=True) for e in leg.equations(own)]
    out = []
    for k in range(len(drives)):
        ends, lengths = (np.real([part[k] for part in parts]) for parts in list(zip(*equations, strict=True))[:2])
        normals = np.real([np.zeros(3) if e.normal is None else e.normal[k] for e in equations])
        flat: BoolArray = np.asarray(normals.any(axis=1))

        def lacks(x: FloatArray, c: FloatArray = ends, n: FloatArray = normals, m: FloatArray = lengths, f: BoolArray = flat) -> FloatArray:
            away = Rotation.from_rotvec(x[:3]).apply(points) + size * x[3:] - c
            return np.asarray(np.where(f, (n * away).sum(axis=1), np.linalg.norm(away, axis=1)) - m)

        x = root(lacks, np.concatenate([turn0, at0 / size]), tol=1e-12).x
        out.append(np.concatenate([size * x[3:], Rotation.from_rotvec(x[:3]).as_quat()]))
    return np.array(out)


def drives_of(robot: Parallel, rng: np.random.Generator) -> FloatArray:
    """(POSES, n) of poses near home that keep the robot's limits: of all six coordinates, or of the drives where these are fewer."""
    count, size = len(robot.joint_names), PART * robot.size_mm
    if count < EQUATIONS:
        reach = np.where(robot.sliding, size, REACH_RAD)
        return np.asarray(robot.home_joints + rng.uniform(-1.0, 1.0, (POSES, count)) * reach)

    def inside(poses: FloatArray) -> BoolArray:
        return checked(robot, robot.bounds, poses).all

    reach = 0.7 * ranges(inside, robot.home, np.array([0.1, 0.1, 0.2, *(2.0 * size,) * 3]))
    moves = reach[:, 0] + rng.uniform(size=(20 * POSES, 6)) * (reach[:, 1] - reach[:, 0])
    poses = se3.displaced(np.tile(robot.home, (len(moves), 1)), moves)
    return own_roots(robot, poses[inside(poses)][:POSES])


def seconds(work: Callable[[], object]) -> float:
    """Median of a few rounds."""
    times = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def main() -> None:
    arguments, rng, rows = options(__doc__).parse_args(), np.random.default_rng(0), []
    for name in ROBOTS:
        robot = any_shipped(name).model
        assert isinstance(robot, Parallel)
        drives = drives_of(robot, rng)
        starts = np.tile(robot.home, (len(drives), 1))
        poses, good = robot.near(drives, starts)
        assert good.all(), name
        near = len(drives) / seconds(lambda r=robot, d=drives, s=starts: r.near(d, s))  # type: ignore[misc]
        way = len(drives) / seconds(lambda r=robot, d=drives: r.forward(d))  # type: ignore[misc]
        other = SLOW / seconds(lambda r=robot, d=drives: generic_robot(r, d[:SLOW]))  # type: ignore[misc]
        again, along = generic_robot(robot, drives[:SLOW]), robot.forward(drives[:SLOW])
        size = np.array([robot.size_mm] * 3 + [1.0] * 3)
        away = max(float(np.abs(se3.displacement(poses[:SLOW], p) * size).max()) for p in (again, along))
        speeds = (f"{one:,.0f}" for one in (near, way, other, near / other, way / other))
        rows.append([name, *speeds, f"{away:.0e} mm"])
        print(*rows[-1], flush=True)
    head = ["robot", "from home", "along the way", "SciPy", "times, from home", "times, along the way", "largest difference"]
    about = "poses/s on one core, medians; SciPy is `root` per pose from home, derivatives by differences"
    show(arguments, f"# Forward problems of mechanisms\n\n`python benchmarks/mechanisms.py`: {about}.\n\n{table(head, rows)}", "mechanisms")


if __name__ == "__main__":
    main()
