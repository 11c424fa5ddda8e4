"""Does the 95 % radius of a zone hold 95 %? Real reconstructions from real counts, at the worst tilt of each place.

python benchmarks/zone_coverage.py [--places N] [--keep FILE] [--write]
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from study import Study, table

from lmeasure.accuracy import scan_zone, tilts
from lmeasure.kernels import screw
from lmeasure.rig import Rig, read_rig
from lmeasure.sensors import changes_from_counts, counts_from_poses, drawn_phases, length_variance, span_lengths

FloatArray = NDArray[np.float64]
START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
RIG = Path(__file__).parents[1] / "datasets" / "thesis-5.7" / "placed.toml"
LENGTH_MM = 0.0125  # full width of a reading: half a count either way, which thesis 5.7 takes for delta_l
DRAWS = 2000
SHARES = (
    "within the radius, lengths with Gaussian errors of that variance",
    "within the radius, whole counts",
    "within what the pressure angle promises, whole counts",
)
HEAD = """# Coverage of the 95 % radius of a zone

`python benchmarks/zone_coverage.py --write`: reconstructions at the worst tilt (to 0.3 rad) of {n} places in the cube of
`datasets/thesis-5.7/placed.toml`, 2,000 each; counters zeroed anywhere within a count. Worst pressure angles of the places {low:.0f} to
{high:.0f} degrees.

"""


def reconstructed(rig: Rig, pose: FloatArray, changes: FloatArray) -> FloatArray:
    """Return (n, 3) tool origins from (n, 6) changes of the cables since the start pose, by the screw method from the pose itself."""
    rows, zero = rig.cable_rows(), span_lengths(rig, START[None])[0]
    return np.array([screw.solve_pose(rows, zero + change, pose)[3][:3] for change in changes])


def worst_pose(rig: Rig, at: FloatArray) -> tuple[FloatArray, float, float]:
    """Return the pose with the tilt of the largest radius, that radius, and the worst angle of all tilts."""
    turns = tilts(0.3, 3)
    zones = [scan_zone(rig, None, x=at[:1], y=at[1:2], z=at[2:], rotations=turns[i : i + 1]) for i in range(len(turns))]
    radius = [zone["u95_position_mm"].item() for zone in zones]
    i = int(np.argmax(radius))
    return np.concatenate([at, turns[i].as_quat()]), radius[i], max(zone["worst_pressure_angle_deg"].item() for zone in zones)


def draw(seed: int) -> list[float]:
    """Return the three shares at one place, and the worst pressure angle there, of the counts alone."""
    rng, rig = np.random.default_rng(seed), read_rig(RIG).model_copy(update={"unstated": "exact"})
    at = rng.uniform(-300, 300, 3)
    pose, radius, angle = worst_pose(rig, at)
    true = span_lengths(rig, pose[None])[0] - span_lengths(rig, START[None])[0]
    gaussian = reconstructed(rig, pose, true + np.sqrt(length_variance(rig)) * rng.standard_normal((DRAWS, 6))) - at
    # whole counts, zeroed anywhere within one: the pose moves a little, so that each count falls anywhere within its step
    moved = np.repeat(pose[None], DRAWS, axis=0)
    moved[:, :3] += rng.uniform(-1, 1, (DRAWS, 3))
    moved[:, 3:] = (Rotation.from_rotvec(rng.uniform(-0.003, 0.003, (DRAWS, 3))) * Rotation.from_quat(pose[3:])).as_quat()
    counts = np.rint(counts_from_poses(rig, moved, START) + [drawn_phases(rig, rng) for _ in range(DRAWS)])
    found = [reconstructed(rig, own, change[None])[0] for own, change in zip(moved, changes_from_counts(rig, counts), strict=True)]
    rounded = np.linalg.norm(np.array(found) - moved[:, :3], axis=1)
    promised = LENGTH_MM / np.cos(np.radians(angle))
    shares = [np.mean(np.linalg.norm(gaussian, axis=1) <= radius), np.mean(rounded <= radius), np.mean(rounded <= promised)]
    return [*map(float, shares), angle]


def page(records: list[list[float]]) -> tuple[str, bool]:
    """Return the page of results, and whether the shares are those of a 95 % radius."""
    found = np.array(records)
    n, shares = len(found), 100.0 * found[:, :3]
    rows = [(name, f"{each.mean():.1f} %", f"{each.min():.1f} to {each.max():.1f} %") for name, each in zip(SHARES, shares.T, strict=True)]
    # a place's share of a true 0.95 has a standard deviation of 0.5 points; sums of uniform errors have thinner tails
    good = abs(shares[:, 0].mean() - 95.0) < 2.5 / np.sqrt(n) and np.abs(shares[:, 0] - 95.0).max() < 2.5 and shares[:, 1].min() > 92.0
    text = HEAD.format(n=n, low=found[:, 3].min(), high=found[:, 3].max())
    return text + table(["share of the positions", "all", "over the places"], rows), bool(good)


if __name__ == "__main__":
    raise SystemExit(Study("zone_coverage", draw, page, runs="places", count=20).command(__doc__))
