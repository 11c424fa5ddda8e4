"""Slips in the files of a calibration: found and corrected, set aside or refused, or delivered in a rig that is worse than the nominal one?

    python benchmarks/campaign_slips.py --campaigns 60 --keep benchmarks/results/campaign_slips.jsonl [--slip NAME ...] [--write]

Rigs and counts come from an independent forward model (tests/helpers/real_rig.py). Campaigns have 8, 12 or 20 poses in turn. Positions
err by 0.02
to 0.05 mm, orientations by 50 microradians; the file states this, or in every second campaign nothing. The nominal rig is 1 mm and 0.5
degrees off, in every third campaign 5 mm and 2 degrees. Each campaign is written to its files with one slip, and read and calibrated as a
user does. A rig is judged by its changes of lengths at 200 other poses, against the same campaign without a slip and the nominal rig.
"""

import csv
import math
import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from study import Asked, Study

TESTS = Path(__file__).parent.parent / "tests"
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

import real_rig  # noqa: E402
from real_rig import Flaws, RealRig  # noqa: E402

from lmeasure.calibration import calibrate, read_campaign, without_slips  # noqa: E402
from lmeasure.core import LMeasureError  # noqa: E402
from lmeasure.rig import Rig, rig_from_dict, write_rig  # noqa: E402
from lmeasure.sensors import span_lengths  # noqa: E402

FloatArray = NDArray[np.float64]
POSES = (8, 12, 20)


class World:
    """A rig, its nominal one, and the tables of a sound campaign as lists of numbers."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 97])
        self.seed, self.n = seed, POSES[seed % 3]
        self.truth: RealRig = real_rig.draw(seed, Flaws())
        off = (5.0, 2.0) if seed % 3 == seed // 3 % 3 else (1.0, 0.5)
        self.nominal: Rig = rig_from_dict(self.truth.drawing(rng, *off))
        self.u_mm = float(rng.uniform(0.02, 0.05))
        stood = real_rig.scattered(rng, self.n)
        self.counts = self.truth.counts(stood, stood[0], None, 0.0, rng.uniform(-0.5, 0.5, 6))
        self.counts[0] = 0.0
        said = real_rig.stated(rng, stood, self.u_mm, 50e-6)
        self.places, self.turns = np.round(said[:, :3], 3), Rotation.from_quat(said[:, 3:])
        self.judged = real_rig.scattered(np.random.default_rng([seed, 5]), 200)
        self.stated = seed // 3 % 2 == 0

    def angles(self, axes: str = "ZYX") -> FloatArray:
        """(n, 3) in degrees."""
        return np.round(self.turns.as_euler(axes, degrees=True), 4)

    def error_mm(self, rig: Rig) -> float:
        """Root mean square of the errors of the changes of lengths at the poses that judge."""
        # of a rig with two passes the second is the one that was counted
        error = span_lengths(rig, self.judged)[:, -6:] - self.truth.spans(self.judged)[0]
        return float(np.sqrt(np.mean((error - error.mean(axis=0)) ** 2)))


def _typo(value: float, kind: str, rng: np.random.Generator) -> float:
    """A number with a slip of typing."""
    if kind == "sign":
        return -value
    if kind == "digits swapped":
        whole = f"{abs(value):07.3f}".replace(".", "")
        digits = [i for i in range(2) if whole[i] != whole[i + 1]] or [0]
        i = digits[int(rng.integers(len(digits)))]
        swapped = whole[:i] + whole[i + 1] + whole[i] + whole[i + 2 :]
        return math.copysign(float(swapped) / 1000.0, value)
    return value + float(kind.split()[0]) * rng.choice([-1.0, 1.0])


def slipped(world: World, slip: str) -> tuple[FloatArray, FloatArray, FloatArray, dict[str, Any], str]:
    """Positions, angles, counts, rig as a dictionary, and what a finding must name: with one slip of the files or of the rig."""
    rng = np.random.default_rng([world.seed, sum(map(ord, slip))])
    places, counts = world.places.copy(), world.counts.copy()
    angles: FloatArray = world.angles()
    rig, named = world.nominal.to_dict() | {"angles": "kuka-abc"}, ""
    i, j = int(rng.integers(world.n)), int(rng.integers(6))
    what, _, how = slip.partition(": ")
    if what == "angles":
        if how == "order CBA":
            angles = angles[:, ::-1]
        elif how == "radians":
            angles = np.asarray(np.round(np.radians(angles), 5), dtype=np.float64)
        elif how == "puma-oat":
            angles = np.round(world.turns.as_euler("ZYZ", degrees=True) - [-90.0, 90.0, 0.0], 4)
        elif how == "rotation vector":
            angles = np.round(world.turns.as_rotvec(), 6)
        else:
            angles = world.angles(how)
        named = "angles"
    elif what == "coordinate":
        axis = int(rng.integers(3))
        if how in ("sign", "digits swapped"):
            i = int(np.argmax(np.abs(places[:, axis]) > 30.0))
        places[i, axis] = _typo(places[i, axis], how, rng)
        named = f"outlier {i + 1}"
    elif what == "angle":
        angles[i, int(rng.integers(3))] += float(how.split()[0])
        named = f"outlier {i + 1}"
    elif what == "count":
        i = max(i, 1)
        counts[i, j] += round(float(how.split()[0]) / real_rig.COUNT_MM)
        named = f"outlier {i + 1} ch{j + 1}"
    elif what == "exchanged":
        some = rng.permutation(world.n)[: int(how.split()[0])]
        if "counts" in how:
            counts[some] = counts[np.roll(some, 1)]
        else:
            places[some], angles[some] = places[np.roll(some, 1)], angles[np.roll(some, 1)]
        named = "exchanged_poses"
    elif what == "channel":
        k = (j + 1 + int(rng.integers(5))) % 6
        if how == "swapped":
            counts[:, [j, k]] = counts[:, [k, j]]
        elif how == "sign":
            counts[:, j] *= -1
        elif how == "scale":
            counts[:, j] = np.rint(counts[:, j] / 2)
        elif how == "attachment":
            rig["cable"][j]["to"] = "P1" if rig["cable"][j]["to"] != "P1" else "P2"
        elif how == "slip":
            first = int(rng.integers(2, world.n - 1))
            counts[first:, j] += 500.0
        elif how == "pass":
            moved = {"P1": "P2", "P2": "P3", "P3": "P1"}
            other = [c | {"name": f"d{n}", "pass": 2} for n, c in enumerate(rig["cable"])]
            rig["cable"] = [c | {"to": moved[c["to"]]} for c in rig["cable"]] + other
        named = {"attachment": "attachment", "pass": "pass"}.get(how, how)
    elif what == "inches":
        places = np.round(places / 25.4, 4)
        named = "refused"
    return places, angles, counts, rig, named


SLIPS = (
    "none",
    *(f"angles: {how}" for how in ("XYZ", "xyz", "order CBA", "puma-oat", "radians", "rotation vector")),
    *(f"coordinate: {how}" for how in ("10 mm", "100 mm", "digits swapped", "sign")),
    "angle: 10 deg",
    *(f"count: {how}" for how in ("10 mm", "100 mm")),
    *(f"exchanged: {how}" for how in ("2 poses", "2 poses' counts", "3 poses")),
    *(f"channel: {how}" for how in ("swapped", "sign", "scale", "attachment", "slip", "pass")),
    "inches",
)


def campaign_folder(folder: Path, world: World, slip: str) -> str:
    """Write the files of a campaign with a slip; what a finding must name."""
    places, angles, counts, rig, named = slipped(world, slip)
    write_rig(folder / "rig.toml", rig_from_dict(rig))
    with (folder / "reference_poses.csv").open("w", newline="", encoding="utf-8") as file:
        u = [("u_position_mm", f"{world.u_mm:.4f}"), ("u_rotation_deg", f"{math.degrees(50e-6):.5f}")] if world.stated else []
        out = csv.writer(file)
        out.writerow(["pose", "x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg", *(name for name, _ in u)])
        for i in range(world.n):
            out.writerow([i + 1, *map(float, places[i]), *map(float, angles[i]), *(value for _, value in u)])
    with (folder / "counts.csv").open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(["pose", *(f"ch{j + 1}" for j in range(6))])
        out.writerows([i + 1, *(int(v) for v in counts[i])] for i in range(world.n))
    return named


world_of = lru_cache(1)(World)


def study(seed: int, slip: str) -> dict[str, Any]:
    """One campaign with one slip: what became of it."""
    world = world_of(seed)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        named = campaign_folder(folder, world, slip)
        out = {"seed": world.seed, "slip": slip, "poses": world.n, "nominal_mm": world.error_mm(world.nominal), "error_mm": None}
        try:
            result = calibrate(without_slips(read_campaign(folder), "reference_poses.csv"))
        except LMeasureError as refusal:
            return out | {"codes": [str(refusal)[-200:]], "named": named == "refused", "refused": True}
    codes = [" ".join(filter(None, (w.code, w.pose, w.channel))) for w in result.record.warnings]
    right = not named or any(code == named or code.split()[0] == named for code in codes)
    error = None if result.refused else world.error_mm(result.rig)
    return out | {"codes": codes, "named": right, "refused": result.refused is not None, "error_mm": error}


def table(found: list[dict[str, Any]]) -> str:
    """The page of results."""
    data = pd.DataFrame(found)
    sound = data[data.slip == "none"].set_index("seed").error_mm.astype(float)
    lines = [
        "# Slips in the files of a calibration",
        "",
        f"`python benchmarks/campaign_slips.py`: {data.seed.nunique()} campaigns of 8, 12 and 20 poses, each without a slip and with",
        "four in turn. Errors are root mean squares of changes of lengths at 200 other poses. Worse: delivered with a larger error than",
        "the nominal rig's. Times: error over that of the campaign without the slip, median and worst. A pose that is set aside is lost:",
        "7 of 8 poses are left, and the rig is the one that these give.",
        "",
        "| slip | campaigns | named | delivered | refused | worse than nominal | times, median | times, worst | error, median (mm) |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for slip in SLIPS:
        own = data[data.slip == slip]
        if not len(own):
            continue
        given = own[~own.refused.astype(bool)]
        error = given.error_mm.astype(float)
        times = error / sound.reindex(given.seed).to_numpy()
        worse = int((error > given.nominal_mm).sum())
        reported = [f"{np.median(times):.2f}", f"{np.max(times):.2f}", f"{np.median(error):.4f}"] if len(given) else ["", "", ""]
        counts = [str(v) for v in (len(own), int(own.named.sum()), len(given), len(own) - len(given), worse)]
        lines.append(f"| {slip} | {' | '.join(counts + reported)} |")
    return "\n".join(lines)


def slips_of(options: Asked, seed: int) -> list[tuple[str]]:
    """Return no slip, and four in turn or those that are asked for."""
    some = [SLIPS[1 + (4 * (seed // 3) + k) % (len(SLIPS) - 1)] for k in range(4)] if len(options.slip) == len(SLIPS) else options.slip
    return [("none",), *((slip,) for slip in some if slip != "none")]


STUDY = Study("campaign_slips", study, table, "campaigns", 60, {"slip": SLIPS}, "{seed} {slip}", slips_of)

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
