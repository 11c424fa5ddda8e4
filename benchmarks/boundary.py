"""The boundary of a workspace by following it beside rays in small steps (thesis 5.3) and beside a grid, at one accuracy.

python benchmarks/boundary.py --out benchmarks/results/boundary.md
"""

import time

import numpy as np
from study import options, show

from lmeasure.core import FloatArray
from lmeasure.linkages import Bounds, Slice, boundary
from lmeasure.structure.slices import PLANES, slices

# thesis 5.3: pairs B1, B4 - P1; B2, B5 - P2; B3, B6 - P3
BODY = np.array([(0, -1, 0), (1, 0, 0), (0, 1, 0)] * 2, dtype=float)
BASE = np.array([(0, -5, 0), (5, 0, 0), (-4, 1, 0), (0, -1, -4), (1, 0, -4), (0, 1, -4)], dtype=float)
PIECE = 20_000  # poses at a time
STEP_MM = 2.0  # of the walk that finds how the boundary runs, whatever is asked
BESIDE = np.linspace(0.0, 1.0, 42)[1:-1]  # of a line: where it is measured beside the limit


def lines_off(bounds: Bounds, plane: Slice, places: FloatArray) -> float:
    """By how much the lines between places are beside the limit at most, at forty places of each [mm]."""
    way = np.roll(places, -1, axis=0) - places
    values, rates = bounds.with_rates(plane.poses(places[:, None] + BESIDE[:, None] * way[:, None]), plane.displacements)
    return float(np.abs((values / np.linalg.norm(rates, axis=-1)).min(axis=-1)).max())


def cell_of_the_origin() -> list[str]:
    """Every level of three planes in windows of three sizes: rays against what was followed, by the closed form z + 4 = |x - y|."""
    page = [
        "",
        "The cell of the origin without a limit angle is z + 4 > |x - y| (closed form). 25 levels from -3 to 3 mm in each plane:",
        "",
        "| plane | reach, mm | places | outside the cell by at most, mm | off its edge, mm | rays | rays beside the lines by at most, mm |",
        "|---" * 7 + "|",
    ]
    home = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    bounds = Bounds(BASE, BODY, home)
    turns = 2.0 * np.pi * (np.arange(180) + 0.5) / 180
    for plane, (a, b, axis) in PLANES.items():
        for reach in (8.0, 10.0, 25.0):
            out, off, count, rays, beside = 0.0, 0.0, 0, 0, 0.0
            for level in np.linspace(-3.0, 3.0, 25):
                pieces, _ = slices(bounds, home, plane, [float(level)], reach_mm=reach)
                if not pieces:
                    raise SystemExit(f"{plane} at {level:g} mm, reach {reach:g} mm: no boundary")
                x, y, z = np.vstack([piece.places for piece in pieces]).T
                edge = z + 4.0 - np.abs(x - y)
                out, off, count = max(out, float(-edge.min())), max(off, float(np.abs(edge).max())), count + len(x)
                start = np.zeros(3)
                start[axis] = level
                if start[2] + 4.0 <= abs(start[0] - start[1]):
                    continue  # the pose's own place at this level lies outside
                for turn in turns:
                    way = np.zeros(3)
                    way[[a, b]] = np.cos(turn), np.sin(turn)
                    met = met_in_closed_form(start, way)
                    if met < 0.98 * reach:
                        rays += 1
                        place = (start + met * way)[[a, b]]
                        beside = max(beside, min(apart(place, piece.places[:, [a, b]]) for piece in pieces))
            page.append(f"| {plane} | {reach:g} | {count} | {out:.0e} | {off:.0e} | {rays} | {beside:.0e} |")
    return page


def met_in_closed_form(start: FloatArray, way: FloatArray) -> float:
    """Where a ray leaves z + 4 > |x - y| [mm]: the lesser of two straight lines along it."""
    values = [start[2] + 4.0 - sign * (start[0] - start[1]) for sign in (1.0, -1.0)]
    rates = [way[2] - sign * (way[0] - way[1]) for sign in (1.0, -1.0)]
    return min((-value / rate for value, rate in zip(values, rates, strict=True) if rate < 0.0), default=np.inf)


def apart(place: FloatArray, line: FloatArray) -> float:
    """Distance of a place from a line of straight pieces [mm]."""
    begin, way = line[:-1], np.diff(line, axis=0)
    part = np.clip(((place - begin) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-300), 0.0, 1.0)
    return float(np.linalg.norm(begin + part[:, None] * way - place, axis=1).min())


def main() -> None:
    """Print the page, or write it."""
    parser = options(__doc__)
    arguments = parser.parse_args()
    level = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    bounds = Bounds(BASE, BODY, level, np.radians(84.0))
    plane = Slice(level, np.array([(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)]), 40.0)
    began = time.process_time()
    found = boundary(bounds, plane, np.array([0.2, -1.0]), STEP_MM)
    follow = time.process_time() - began
    off = float(np.abs(bounds.values(plane.poses(found.places)).min(axis=1)).max())
    low, high = found.places.min(axis=0), found.places.max(axis=0)
    rng = np.random.default_rng(0)
    draws = low + (high - low) * rng.uniform(size=(PIECE, 2))
    bounds.inside(plane.poses(draws))
    began = time.process_time()
    bounds.inside(plane.poses(draws))
    each = (time.process_time() - began) / PIECE
    rays = len(found.places)
    radius = float(np.linalg.norm(found.places, axis=1).mean())
    page = ["# Boundary of a workspace, followed and scanned", "", "`benchmarks/boundary.py`; times are those of one processor.", ""]
    page.append(
        f"Slice y = 1 of the example of 5.3 with 84 degrees: {rays} places, closed, each on its limit to {off:.0e} of the determinant, "
        f"in {follow:.2f} s. A pose is judged in {1e6 * each:.1f} us, in batches."
    )
    page += [
        "",
        "| accuracy, mm | followed, places | lines off, mm | its time, s | nodes of a grid | its time, s | times "
        "| steps along as many rays | their time, s | times |",
        "|---" * 10 + "|",
    ]
    for accuracy in (1e-1, 1e-2, 1e-3):
        began = time.process_time()
        line = boundary(bounds, plane, np.array([0.2, -1.0]), STEP_MM, within_mm=accuracy)
        spent, count = time.process_time() - began, len(line.places)
        off_line = lines_off(bounds, plane, line.places)
        nodes, steps = float(np.prod((high - low) / accuracy)), count * radius / accuracy
        grid, ray = nodes * each, steps * each
        page.append(
            f"| {accuracy:.0e} | {count} | {off_line:.1e} | {spent:.2f} | {nodes:.1e} | {grid:.1e} | {grid / spent:.1e} "
            f"| {steps:.1e} | {ray:.1e} | {ray / spent:.1e} |"
        )
    page += ["", "Times of grids and rays are the number of their poses times that of one pose, judged at 20,000 of them."]
    page.append(
        "Followed places are on the limit to rounding whatever is asked; straight lines between them keep the accuracy, as measured at "
        "forty places of each."
    )
    page += cell_of_the_origin()
    show(arguments, "\n".join(page), "boundary")


if __name__ == "__main__":
    main()
