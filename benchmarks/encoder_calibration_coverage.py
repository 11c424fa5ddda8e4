"""Calibrations with encoders of angles, drawn again and again: do their regions hold the truth as often as they say?

    python benchmarks/encoder_calibration_coverage.py --draws 200 [--kind swivels] [--keep coverage.jsonl --seconds 500] [--write]

Three kinds: at poses known to 0.05 mm (`swivels`), by a motion of which no pose is known (`self`), and a record of 14 poses that goes on
from another motion (`continue`). Six cables with six encoders of 17 bits whose zeros are known to 2 degrees, counters zeroed anywhere
within a count, a nominal rig that is off by a third of its uncertainties. Of the first and the last all values together lie within
their 95 % region; of the second, whose frame is its own, the distance of two of its points.
"""

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy.stats
from scipy.spatial.transform import Rotation
from study import Study

from lmeasure.calibration import CalibrationSettings, Campaign, calibrate, continued, unknowns_of
from lmeasure.calibration.solve.run_samples import campaign_of
from lmeasure.core import se3
from lmeasure.recording import Poses
from lmeasure.rig import CalibrationRecord, Rig, rig_from_dict, value_of, with_values
from lmeasure.sensors import counts_from_poses, drawn_phases, recorded_from_counts
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path

HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])
COVERAGE = 0.95


def true_rig(seed: int) -> Rig:
    """A cell with an encoder on every pulley."""
    data, rng = cell_rig(seed % 7 + 1).to_dict(), np.random.default_rng([seed, 2])
    data["swivel"] = [
        {
            "point": f"B{i}",
            "channel": f"sw{i}",
            "counts_per_revolution": 2**17,
            "zero_deg": float(rng.uniform(-180, 180)),
            "u_zero_deg": 2.0,
        }
        for i in range(1, 7)
    ]
    return rig_from_dict(data)


def drawn_campaign(true: Rig, rng: np.random.Generator, poses: int, u_mm: float) -> tuple[Campaign, np.ndarray]:
    """What is counted at poses that are known to u_mm, with a nominal rig, and the true poses."""
    rows = np.column_stack([rng.uniform(-300, 300, (poses, 3)), Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (poses, 3))).as_quat()])
    counts = counts_from_poses(true, rows, rows[0], true.observed)
    counts = recorded_from_counts(true, counts, true.observed, drawn_phases(true, rng, true.observed))
    stated = rows.copy()
    stated[:, :3] += rng.normal(0, u_mm, (poses, 3))
    reference = Poses(tuple(map(str, range(poses))), stated, np.full(poses, u_mm), np.zeros(poses))
    campaign = Campaign(true, reference, true.observed, counts, np.zeros(len(true.observed), np.int64))
    unknowns = unknowns_of(campaign, ("position", "guide"))
    off = unknowns.nominal + rng.normal(size=len(unknowns.names)) * unknowns.width / 3.0
    return replace(campaign, rig=with_values(true, dict(zip(unknowns.names, off.tolist(), strict=True)))), rows


def held(record: CalibrationRecord, true: Rig) -> bool:
    """Whether all values together lie within their 95 %."""
    off = np.array([p.value - (value_of(true, p.name) or 0.0) for p in record.parameters])
    off = np.array(
        [np.remainder(d + 180.0, 360.0) - 180.0 if p.name.endswith("_deg") else d for d, p in zip(off, record.parameters, strict=True)]
    )
    return bool(off @ np.linalg.solve(record.tangent_matrix(), off) < scipy.stats.chi2.ppf(COVERAGE, len(off)))


def by_poses(seed: int) -> bool:
    """At poses known to 0.05 mm."""
    rng, true = np.random.default_rng([seed, 1]), true_rig(seed)
    return held(calibrate(drawn_campaign(true, rng, 14, 0.05)[0]).record, true)


def by_motion(seed: int) -> bool:
    """By unknown poses: the distance of two observation points, in which it cancels where the frame lies."""
    rng, true = np.random.default_rng([seed, 3]), true_rig(seed)
    record = calibrate(drawn_campaign(true, rng, 24, 2.0)[0], CalibrationSettings(self_calibration=True)).record
    found, truth = (
        np.array([[of[f"{p.name}.{axis}_mm"] for axis in "xyz"] for p in true.observation_point])
        for of in ({p.name: p.value for p in record.parameters}, {p.name: value_of(true, p.name) or 0.0 for p in record.parameters})
    )
    one, other = rng.choice(len(truth), 2, replace=False)
    e = (found[one] - found[other]) / np.linalg.norm(found[one] - found[other])
    way = {
        f"{true.observation_point[k].name}.{axis}_mm": sign * float(part)
        for k, sign in ((one, 1.0), (other, -1.0))
        for axis, part in zip("xyz", e, strict=True)
    }
    g = np.array([way.get(p.name, 0.0) for p in record.parameters])
    u = np.sqrt(g @ record.tangent_matrix() @ g)
    return bool(abs(np.linalg.norm(found[one] - found[other]) - np.linalg.norm(truth[one] - truth[other])) < 1.96 * u)


def by_run(seed: int) -> bool:
    """A record that goes on from a run."""
    rng, true = np.random.default_rng([seed, 4]), true_rig(seed)
    begun = calibrate(drawn_campaign(true, rng, 14, 0.05)[0])
    legs = [
        Leg(se3.pose(rng.uniform(-250, 250, 3), Rotation.from_rotvec(rng.uniform(-0.25, 0.25, 3))), 800.0, 60.0, 0.0) for _ in range(10)
    ]
    time_s, poses = smooth_path(HOME, legs, 50.0)
    run = replace(simulate_run(true, time_s, poses, noise_mm=0.0, rng=rng).run, rig=begun.rig, calibration=begun.record)
    return held(continued(campaign_of(run, 24), begun.record).record, true)


KINDS: dict[str, Callable[[int], bool]] = {"swivels": by_poses, "self": by_motion, "continue": by_run}


def drawn(number: int, kind: str) -> list[str | bool]:
    """The kind, and whether its draw of this number held the truth."""
    return [kind, bool(KINDS[kind](number))]


def table(every: list[list[str | bool]]) -> tuple[str, bool]:
    """The page of results, and whether all is consistent with what is stated."""
    lines = ["# Coverage of calibrations with encoders", "", (__doc__ or "").split("\n\n")[2].strip(), ""]
    lines += ["| kind | held the truth | consistent with 95 % |", "|---|---|---|"]
    good = True
    for kind in KINDS:
        own = [held for name, held in every if name == kind]
        times, n = sum(map(bool, own)), len(own)
        low, high = (int(scipy.stats.binom.ppf(q, n, COVERAGE)) for q in (5e-4, 1 - 5e-4))
        # a distance of poses whose errors the frame correlates is stated too wide, by their own covariances alone
        good &= low <= times and (times <= high or kind == "self")
        lines.append(f"| {kind} | {times} of {n} | {low} to {high} |")
    return "\n".join([*lines, "", "All consistent." if good else "NOT consistent.", ""]), good


STUDY = Study("encoder_calibration_coverage", drawn, table, "draws", 200, {"kind": tuple(KINDS)})

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
