"""Campaigns and runs of `real_rig`, as a metrologist has them, and how well a calibration of one measures the other."""

from dataclasses import dataclass, field, replace

import numpy as np
import real_rig
import scipy.stats
from numpy.typing import NDArray
from real_rig import Flaws, RealRig
from scipy.spatial.transform import Rotation

from lmeasure.calibration import Calibration, Campaign
from lmeasure.recording import Counts, Poses, Run
from lmeasure.rig import CalibrationRecord, Rig, rig_from_dict
from lmeasure.trajectory import reconstruct

FloatArray = NDArray[np.float64]

INSIDE = float(scipy.stats.chi2.ppf(0.95, 6))


@dataclass(frozen=True)
class Case:
    """A campaign whose world is not as stated.

    u_mm, u_rad: true errors of the reference poses; stated: what their file says of them (None: nothing); off: of the drawing's points [mm]
    and guides [deg]; cure: groups to solve for, and the uncertainties that are true, by which a user would state what is the matter.
    """

    flaws: Flaws = field(default_factory=Flaws)
    u_mm: float = 0.05
    u_rad: float = 50e-6
    stated: tuple[float, float] | None = (0.05, 50e-6)
    off: tuple[float, float] = (1.0, 0.5)
    cure: tuple[str, ...] = ()
    poses: int = 20
    warmer_k: float = 0.0
    """Of the run than of the campaign."""


@dataclass(frozen=True)
class RealCampaign:
    """The campaign, the true rig behind it, and a run of it: true poses (n, 7) and recorded counts (n, m)."""

    campaign: Campaign
    truth: RealRig
    poses: FloatArray
    counts: FloatArray


@dataclass(frozen=True)
class Score:
    """Of a run: root mean square error of the tool's place [mm], share of samples in their 95 % region (six degrees of freedom), mean
    squared error over the stated covariance, per degree of freedom."""

    error_mm: float
    inside: float
    squares: float


def make(case: Case, seed: int, samples: int = 200, cables: int = 6) -> RealCampaign:
    """A drawn rig, its campaign and a run: counters zeroed anew for the run, each reading come to from either side."""
    truth, rng = real_rig.draw(seed, case.flaws, cables), np.random.default_rng([seed, 7])
    m = len(truth.base)
    stood = real_rig.scattered(rng, case.poses)
    counts = truth.counts(stood, stood[0], rng.choice([-1.0, 1.0], (case.poses, m)), 0.0, rng.uniform(-0.5, 0.5, m))
    counts[0] = 0.0  # where the counters were zeroed
    said = real_rig.stated(rng, stood, case.u_mm, case.u_rad)
    n = len(said)
    u_mm, u_rad = case.stated or (0.0, 0.0)
    absent = () if case.stated else ("position", "rotation")
    poses = Poses(tuple(map(str, range(1, n + 1))), said, np.full(n, u_mm), np.full(n, u_rad), absent=absent)
    nominal = rig_from_dict(truth.drawing(rng, *case.off))
    campaign = Campaign(nominal, poses, nominal.cable, counts, np.zeros(m, dtype=np.int64))
    way = real_rig.path(rng, samples)
    true = truth.true_counts(way, way[0], case.warmer_k)
    recorded = truth.counts(way, way[0], np.sign(np.gradient(true, axis=0)), case.warmer_k, rng.uniform(-0.5, 0.5, m))
    return RealCampaign(campaign, truth, way, recorded)


def reported(made: RealCampaign, case: Case) -> Campaign:
    """The campaign with the true uncertainties of its poses stated."""
    n = len(made.campaign.poses)
    poses = replace(made.campaign.poses, u_position_mm=np.full(n, case.u_mm), u_rotation_rad=np.full(n, case.u_rad), absent=())
    return replace(made.campaign, poses=poses)


def score(rig: Rig, record: CalibrationRecord | None, made: RealCampaign) -> Score:
    """The run reconstructed with a rig and, if there is one, its record."""
    counts = Counts(np.linspace(0.0, 0.05 * len(made.poses), len(made.poses)), tuple(c.channel for c in rig.cable), made.counts)
    found = reconstruct(Run(rig.model_copy(update={"calibration": None}), made.poses[0], (counts,), record, unstated="exact"))
    known = ~np.isnan(found.poses[:, 0])
    true, poses = made.poses[known], found.poses[known]
    turn = (Rotation.from_quat(true[:, 3:]) * Rotation.from_quat(poses[:, 3:]).inv()).as_rotvec()
    error = np.hstack([turn, true[:, :3] - poses[:, :3]])
    squares = np.einsum("ni,ni->n", error, np.linalg.solve((found.random + found.systematic)[known], error[..., None])[..., 0])
    place = float(np.sqrt(np.mean(np.sum(error[:, 3:] ** 2, axis=1))))
    return Score(place, float(np.mean(squares <= INSIDE)), float(np.mean(squares)) / 6.0)


def score_of(result: Calibration, made: RealCampaign) -> Score:
    """The run reconstructed with what a calibration gave."""
    return score(result.rig, result.record, made)
