"""Slow study over random rigs, calibrations and runs: do the stated 95 % regions of a pose hold the true one in 95 %?

    python benchmarks/trajectory_coverage.py --rig calibrated --noise gaussian --cases 500 --keep cases.jsonl [--write]

A case is one drawn rig, a calibration campaign of it, a start pose that is off by what is stated of it, and a run of which one pose is
drawn; its number is the seed. Of a known rig nothing is uncertain but the counts. Campaign and run have counters that were zeroed anywhere
within a count, each a draw of its own. The regions are ellipsoids of the position (tool origin) and of the rotation vector, from the sum of
the random and the systematic covariance. Gaussian noise has the variance of a whole count, rounded counts are whole. Seeds whose rig
cannot measure its run are passed over, and --keep goes on from what is kept.
"""

import itertools
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp
from scipy.stats import binomtest, chi2
from study import Study

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from random_campaigns import Drawn, draw, true_values

from lmeasure.calibration import Model, unknowns_of
from lmeasure.calibration.solve.unknowns import rig_with
from lmeasure.core import LMeasureError, Status
from lmeasure.estimation import fit
from lmeasure.kernels import screw
from lmeasure.recording import Counts, Run
from lmeasure.rig import CalibrationRecord, RecordedParameter, Rig
from lmeasure.sensors import counts_from_poses, drawn_phases
from lmeasure.trajectory import reconstruct

FloatArray = NDArray[np.float64]

POSES = 16
U_REFERENCE_MM = 0.05
U_START = (0.05, 0.0002)  # mm, rad
SAMPLES = 400
LARGEST_ANGLE_DEG = 70.0  # of the run: nearer to a singular pose no region is an ellipsoid
PROBABILITY = 0.95
KINDS = ("position", "rotation")
RIGS, NOISES = ("calibrated", "known"), ("gaussian", "rounded")


@dataclass(frozen=True)
class Case:
    """One pose: its squared errors in units of the stated covariances, three degrees of freedom each."""

    seed: int
    rig: str
    noise: str
    position: float
    rotation: float


def case_of(seed: int, rig: str, noise: str) -> Case | None:
    """The case of a seed, or None where the drawn rig cannot measure the drawn run."""
    try:
        return _case_of(seed, rig, noise)
    except LMeasureError as error:
        print(f"{seed}: {error}", file=sys.stderr)
        return None


def _case_of(seed: int, rig: str, noise: str) -> Case | None:
    rng = np.random.default_rng([seed, 20])
    drawn = draw(seed, points=6, poses=POSES, noise=noise, u_position_mm=U_REFERENCE_MM, phased=True)
    poses = way(rng)
    rows = drawn.truth.cable_rows()
    angles = screw.pose_pressure_angles(rows, poses)
    if not np.degrees(angles.max()) <= LARGEST_ANGLE_DEG:
        return None
    recorded = counts_from_poses(drawn.truth, poses, poses[0]) + drawn_phases(drawn.truth, rng)
    recorded = np.rint(recorded) if noise == "rounded" else recorded + rng.normal(0.0, 1.0 / np.sqrt(12.0), recorded.shape)
    counts = Counts(np.arange(SAMPLES, dtype=np.float64) / 1000.0, tuple(c.channel for c in drawn.truth.cable), recorded)
    run = Run(drawn.truth, poses[0], (counts,), unstated="exact")
    if rig == "calibrated":
        stated, (found, record) = displaced(poses[0], rng), calibrated(drawn)
        run = Run(found, stated, (counts,), record, U_START, unstated="exact")
    trajectory = reconstruct(run)
    i = int(rng.integers(SAMPLES))
    if trajectory.status[i] != Status.OK:
        return None
    covariance = trajectory.random[i] + trajectory.systematic[i]
    position = poses[i, :3] - trajectory.poses[i, :3]
    rotation = (Rotation.from_quat(poses[i, 3:]) * Rotation.from_quat(trajectory.poses[i, 3:]).inv()).as_rotvec()
    return Case(seed, rig, noise, distance(position, covariance[3:, 3:]), distance(rotation, covariance[:3, :3]))


def calibrated(drawn: Drawn) -> tuple[Rig, CalibrationRecord]:
    """What `calibrate` finds, by its last step alone: the joint least squares from the true values, without the search for where to start
    it, which takes two hundred times as long."""
    campaign = drawn.campaign
    unknowns = unknowns_of(campaign, ("position", "guide"))
    model = Model(campaign, unknowns)
    found = fit(model, true_values(drawn, list(unknowns.names)))
    u = np.sqrt(np.diag(found.covariance))
    record = CalibrationRecord(
        rig=campaign.rig.name,
        parameters=tuple(
            RecordedParameter(name=name, value=float(v), u=float(s), prior_u=float(w))
            for name, v, s, w in zip(unknowns.names, found.theta, u, unknowns.width, strict=True)
        ),
        covariance=tuple(tuple(row) for row in (0.5 * (found.covariance + found.covariance.T)).tolist()),
        residuals=(),
        equations=model.equations,
        unknowns=len(unknowns.names),
        rank=found.rank,
    )
    return rig_with(campaign, unknowns, found.theta, None), record


def way(rng: np.random.Generator) -> FloatArray:
    """(SAMPLES, 7) poses from one random pose of the work space to another."""
    ends = rng.uniform(-250, 250, (2, 3))
    turns = Rotation.from_rotvec(rng.uniform(-0.25, 0.25, (2, 3)))
    s = 0.5 - 0.5 * np.cos(np.linspace(0, np.pi, SAMPLES))
    return np.column_stack([ends[0] + s[:, None] * (ends[1] - ends[0]), Slerp([0, 1], turns)(s).as_quat()])


def displaced(start: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A stated start pose: the true one off by the uncertainties that are stated with it."""
    turned = Rotation.from_rotvec(rng.normal(0, U_START[1], 3)) * Rotation.from_quat(start[3:])
    return np.r_[start[:3] + rng.normal(0, U_START[0], 3), turned.as_quat()]


def distance(error: FloatArray, covariance: FloatArray) -> float:
    """Squared error in units of its covariance."""
    return float(error @ np.linalg.solve(covariance, error))


def table(found: list[Case]) -> str:
    """The study in Markdown."""
    limit = float(chi2.ppf(PROBABILITY, 3))
    lines = [
        "# Coverage of the poses' regions",
        "",
        "`python benchmarks/trajectory_coverage.py`: random rigs of six drums, each calibrated from 16 reference poses off by 0.05 mm per",
        f"axis, each in one run of {SAMPLES} samples whose start is off by {U_START[0]:g} mm and {U_START[1]:g} rad per axis; one pose",
        "drawn from each. Of a known rig, and its start, only the counts err. Counters are zeroed anywhere within a count, in the campaign",
        "and in the run.",
        "",
        "| rig | noise of the counts | seeds | cases | region of the | inside the 95 % | p (two-sided) |",
        "|---|---|---|---:|---|---:|---:|",
    ]
    for rig, noise in itertools.product(RIGS, NOISES):
        rows = [case for case in found if (case.rig, case.noise) == (rig, noise)]
        if not rows:
            continue
        seeds = [case.seed for case in rows]
        for kind in KINDS:
            inside = sum(getattr(case, kind) <= limit for case in rows)
            p = binomtest(inside, len(rows), PROBABILITY).pvalue
            share = 100.0 * inside / len(rows)
            lines.append(f"| {rig} | {noise} | {min(seeds)} to {max(seeds)} | {len(rows)} | {kind} | {share:.2f} % | {p:.3f} |")
    return "\n".join([*lines, ""])


STUDY = Study("trajectory_coverage", case_of, table, "cases", factors={"rig": RIGS, "noise": NOISES}, record=Case)

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
