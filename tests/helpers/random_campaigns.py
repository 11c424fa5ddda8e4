"""Random rigs and campaigns with a known truth, for every estimator to be held to."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure.calibration import CalibrationSettings, Campaign, Model, unknowns_of
from lmeasure.calibration.solve.frame import in_frame, model_of
from lmeasure.calibration.solve.unknown_poses import free_components
from lmeasure.recording import Poses
from lmeasure.rig import CalibrationRecord, Rig, rig_from_dict
from lmeasure.sensors import counts_from_poses

FloatArray = NDArray[np.float64]

COUNT_MM = 0.012


@dataclass(frozen=True)
class RandomCampaign:
    """A campaign as the metrologist has it (nominal rig, reference poses as the robot states them), with the true rig behind it."""

    campaign: Campaign
    truth: Rig
    poses: FloatArray
    """(n, 7) the true poses."""


def draw(
    seed: int,
    *,
    points: int = 1,
    poses: int = 14,
    noise: str = "gaussian",
    u_position_mm: float = 0.0,
    attachments: int = 3,
    off: tuple[float, float] = (0.0, 0.0),
    oriented: bool = True,
    spread: tuple[float, float] = (300.0, 0.3),
    phased: bool = False,
) -> RandomCampaign:
    """A rig of drums on a shell around the cell, a campaign in it, and a nominal rig off by its own prior uncertainties.

    noise: "gaussian" adds to every count what whole counts add in variance, "rounded" rounds; u_position_mm is drawn on the stated
    reference poses. attachments: points of the tool that the cables lead to in turn, one of them its origin; off: what the reference poses
    are wrong by beside it, unstated [mm, rad]; not oriented: their positions alone are known; spread: of the poses [mm, rad]; phased: the
    counters were zeroed anywhere within a count, else exactly.
    """
    rng = np.random.default_rng([seed, points, poses])
    data = {
        "schema": "lmeasure.rig/1",
        "unstated": "exact",
        "name": f"drawn {seed}",
        "observation_point": [_point(f"B{i + 1}", rng, not phased) for i in range(points)],
        "tool": _tool(attachments),
        "cable": [
            {"name": f"c{i + 1}", "channel": f"ch{i + 1}", "from": f"B{i + 1}", "to": f"P{i % attachments + 1}"} for i in range(points)
        ],
    }
    truth = rig_from_dict(data)
    half, tilt = spread
    rows = np.column_stack([rng.uniform(-half, half, (poses, 3)), Rotation.from_rotvec(rng.uniform(-tilt, tilt, (poses, 3))).as_quat()])
    counts = counts_from_poses(truth, rows, rows[0])
    phase = np.random.default_rng([seed, 7]).uniform(-0.5, 0.5, points) if phased else np.zeros(points)
    if noise == "rounded":
        counts = np.rint(counts + phase)
    else:
        counts[1:] += phase + rng.normal(0, 1 / np.sqrt(12), (poses - 1, points))
    stated = rows.copy()
    stated[:, :3] += rng.normal(0, 1, (poses, 3)) * u_position_mm
    if any(off):
        stated[:, :3] += rng.normal(0, 1, (poses, 3)) * off[0]
        stated[:, 3:] = (Rotation.from_rotvec(rng.normal(0, 1, (poses, 3)) * off[1]) * Rotation.from_quat(stated[:, 3:])).as_quat()
    if not oriented:
        stated[:, 3:] = 0.0, 0.0, 0.0, 1.0
    names = tuple(str(i + 1) for i in range(poses))
    reference = Poses(names, stated, np.full(poses, u_position_mm), np.zeros(poses), oriented=oriented)
    nominal = truth.to_dict()
    for p in nominal["observation_point"]:
        p["position_mm"] = (np.array(p["position_mm"]) + rng.normal(0, 30, 3).clip(-75, 75)).tolist()
        for key in ("guide_alpha_deg", "guide_beta_deg"):
            p[key] = float(p[key] + np.clip(rng.normal(0, 5), -12, 12))
    campaign = Campaign(rig_from_dict(nominal), reference, truth.cable, counts, np.zeros(points, dtype=np.int64))
    return RandomCampaign(campaign, truth, rows)


def _tool(attachments: int) -> dict[str, list[float]]:
    if attachments == 1:
        return {"P1": [0.0, 0.0, 0.0]}
    return {f"P{i + 1}": [150 * float(np.cos(a)), 150 * float(np.sin(a)), 0.0] for i, a in enumerate(np.radians([90, 210, 330]))}


def _point(name: str, rng: np.random.Generator, zero_exact: bool) -> dict[str, object]:
    """A pulley 1.2 to 2.2 m from the cell's centre whose drum stands behind and below it."""
    way = rng.normal(size=3)
    way[2] = abs(way[2]) - 0.3
    way /= np.linalg.norm(way)
    place = way * rng.uniform(1200, 2200)
    return {
        "name": name,
        "position_mm": place.tolist(),
        "guide_alpha_deg": rng.uniform(35, 65),
        "guide_beta_deg": float(np.degrees(np.arctan2(place[0], place[1]))) + rng.uniform(-15, 15),
        "pulley_radius_mm": rng.uniform(12, 30),
        "drum": {
            "counts_per_revolution": 6000, "count_length_mm": COUNT_MM, "groove_pitch_mm": rng.uniform(0.8, 1.6),
            "tangent_length_mm": rng.uniform(130, 240), "axial_offset_mm": rng.uniform(20, 30), "zero_exact": zero_exact,
        },
    }  # fmt: skip


def true_values(drawn: RandomCampaign, names: list[str]) -> FloatArray:
    """(p,) true values of the record's parameters."""
    out = []
    for name in names:
        owner, key = name.rsplit(".", 1)
        p = drawn.truth.point(owner)
        holder = p if hasattr(p, key) else p.drum
        out.append(p.position_mm["xyz".index(key[0])] if key in ("x_mm", "y_mm", "z_mm") else float(getattr(holder, key)))
    return np.array(out)


def true_unknowns(model: Model, drawn: RandomCampaign) -> FloatArray:
    """(P,) the true values of the unknowns of rig and poses, moved as a whole to where the choice of the frame puts them."""
    theta = shifted(model, true_values(drawn, list(model.parameters.names)), drawn.poses)
    return theta if model.frame is None else in_frame(model, theta, model.frame)


def shifted(model: Model, values: FloatArray, rows: FloatArray) -> FloatArray:
    """(P,) the unknowns at values (p,) of the rig and poses (n, 7)."""
    stated = model.campaign.poses.rows
    turn = (Rotation.from_quat(rows[:, 3:]) * Rotation.from_quat(stated[:, 3:]).inv()).as_rotvec()
    every = np.column_stack([np.degrees(turn), rows[:, :3] - stated[:, :3]])
    return np.r_[values, every[:, model.free].reshape(-1)]


def errors(drawn: RandomCampaign, record: CalibrationRecord, settings: CalibrationSettings) -> FloatArray:
    """(p,) errors of the record's values, the truth in the frame of the result where that was chosen."""
    names = [p.name for p in record.parameters]
    truth = true_values(drawn, names)
    if settings.self_calibration:
        free = free_components(drawn.campaign, trusted=False)
        model = model_of(drawn.campaign, unknowns_of(drawn.campaign, settings.groups), free, settings.frame)
        truth = true_unknowns(model, drawn)[: model.own]
    error = np.array([p.value for p in record.parameters]) - truth
    return np.where([n.endswith("_deg") for n in names], (error + 180.0) % 360.0 - 180.0, error)


def square_of(record: CalibrationRecord, error: FloatArray) -> float:
    """The square of an error (p,) in units of the record's covariance, which knows nothing of motions of the whole."""
    width = np.array([p.prior_u for p in record.parameters])
    values, vectors = np.linalg.eigh(record.covariance_matrix() / np.outer(width, width))
    reported = len(error) - sum(d["point"] == "frame" for d in record.spectrum)
    return float(np.sum((vectors[:, -reported:].T @ (error / width)) ** 2 / values[-reported:]))


def at_truth(drawn: RandomCampaign) -> Campaign:
    """The same campaign with the true rig as the nominal one."""
    return replace(drawn.campaign, rig=drawn.truth)
