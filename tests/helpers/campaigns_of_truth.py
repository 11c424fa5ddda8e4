"""Campaigns whose truth is known, and what their calibration found."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.calibration import Calibration
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.sensors import span_lengths

TRUTH = Path(__file__).parent.parent / "authorities" / "truth"


def true_rig(nominal: Rig, folder: Path) -> Rig:
    """The nominal rig with the simulator's true observation points."""
    truth = json.loads((folder / "truth.json").read_text())
    data = nominal.to_dict()
    for p in data["observation_point"]:
        t = truth[p["name"]]
        p |= {"position_mm": t["B"], "guide_alpha_deg": t["alpha_deg"], "guide_beta_deg": t["beta_deg"], "pulley_radius_mm": t["R"]}
    return rig_from_dict(data)


def held_out_errors(found: Rig, truth: Rig, poses: int = 150) -> np.ndarray:
    """(poses, m) length errors [mm] at random poses within 300 mm and 0.3 rad of the cell's centre, each cable's mean removed."""
    rng = np.random.default_rng(20)
    rows = np.column_stack([rng.uniform(-300, 300, (poses, 3)), Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (poses, 3))).as_quat()])
    error = span_lengths(found, rows) - span_lengths(truth, rows)
    return np.asarray(error - error.mean(axis=0))


def codes(result: Calibration) -> dict[str, Any]:
    return {w.code: w for w in result.record.warnings}
