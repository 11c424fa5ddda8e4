"""Forward problems of the documents' mechanisms, side by side with what a user would write: SciPy's root finder on the distances.

    python benchmarks/mechanisms.py

Each mechanism is given drives of random poses and finds them again from its home pose; writes benchmarks/results/mechanisms.md.
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from lmeasure import se3
from lmeasure.arrays import FloatArray
from lmeasure.robots.mechanisms import legs, virtual_points
from lmeasure.robots.mechanisms.crank import CrankPlatform
from lmeasure.robots.mechanisms.legs import LegPlatform, Placed
from lmeasure.robots.mechanisms.logos import HookeHexapod
from lmeasure.robots.mechanisms.rotopod import Rotopod

POSES, SLOW, ROUNDS = 20000, 200, 5
RESULTS = Path(__file__).parent / "results" / "mechanisms.md"


def generic(mechanism: LegPlatform, drives: FloatArray, home: FloatArray) -> FloatArray:
    """One pose after the other, by rotation vector and position, derivatives by differences."""
    turn0 = se3.rotation(home).as_rotvec()
    out = []
    for q in drives:
        own = mechanism.legs(q)

        def lacks(x: FloatArray, ends: FloatArray = own.ends, lengths: FloatArray = own.lengths) -> FloatArray:
            return np.asarray(np.linalg.norm(Rotation.from_rotvec(x[:3]).apply(mechanism.points) + 100.0 * x[3:] - ends, axis=1) - lengths)

        x = root(lacks, np.concatenate([turn0, home[:3] / 100.0]), tol=1e-12).x
        out.append(np.concatenate([100.0 * x[3:], Rotation.from_rotvec(x[:3]).as_quat()]))
    return np.array(out)


def seconds(work: Callable[[], object]) -> float:
    """Median of a few rounds."""
    times = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return float(np.median(times))


def main() -> None:
    rng = np.random.default_rng(0)
    crank = CrankPlatform.regular(300.0, 200.0, np.radians(20.0), np.radians(100.0), crank_mm=50.0, height_mm=200.0)
    rotopod = Rotopod.of_triangle(1024.0, 87.0, 1019.8, 980.0)
    logos = HookeHexapod.of_leg(np.array([-460.0, -421.0, 0.0]), np.array([-148.0, -490.0, 793.0]))
    spread = rng.uniform(-1.0, 1.0, (POSES, 6)) * [0.05, 0.05, 0.1, 30.0, 30.0, 30.0]
    high, rest = se3.pose([0.0, 0.0, 800.0], Rotation.identity()), se3.pose(np.zeros(3), Rotation.identity())
    around = [se3.displaced(np.broadcast_to(home, (POSES, 7)), spread) for home in (high, rest)]
    cases: list[tuple[str, LegPlatform, FloatArray, FloatArray, Callable[[FloatArray], Placed]]] = []
    cranks = rng.uniform(-0.5, 0.5, (POSES, 3))
    cases.append(("crank platform, legs", crank, crank.home, cranks, lambda q: legs.forward(crank, q, crank.home)))
    cases.append(("crank platform, virtual points", crank, crank.home, cranks, lambda q: virtual_points.forward(crank, q, crank.home)))
    cases.append(("rotopod", rotopod, high, rotopod.inverse(around[0]), lambda q: legs.forward(rotopod, q, high)))
    cases.append(("LOGOS hexapod", logos, rest, logos.inverse(around[1]), lambda q: legs.forward(logos, q, rest)))
    lines = [
        "# Forward problems of mechanisms",
        "",
        "`python benchmarks/mechanisms.py`: poses/s on one core, medians; SciPy is `root` per pose, derivatives by differences.",
        "",
        "| mechanism | lmeasure | SciPy | times | largest difference |",
        "|---|---|---|---|---|",
    ]
    for name, mechanism, home, drives, forward in cases:
        found = forward(drives)
        assert found.found.all(), name
        own = POSES / seconds(lambda forward=forward, drives=drives: forward(drives))  # type: ignore[misc]
        other = SLOW / seconds(lambda m=mechanism, d=drives, h=home: generic(m, d[:SLOW], h))  # type: ignore[misc]
        away = np.abs(se3.displacement(found.poses[:SLOW], generic(mechanism, drives[:SLOW], home)) * ([100.0] * 3 + [1.0] * 3)).max()
        lines.append(f"| {name} | {own:,.0f} | {other:,.0f} | {own / other:,.0f} | {away:.0e} mm |")
        print(lines[-1])
    RESULTS.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
