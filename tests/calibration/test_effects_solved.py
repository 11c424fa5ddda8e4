"""Physical effects as unknowns: what a machine has is found with its evidence, carried into runs from elsewhere, and not invented."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.accuracy.zone import drum_variance
from lmeasure.api import reconstruct
from lmeasure.calibration import Calibration, CalibrationSettings, Campaign, calibrate
from lmeasure.core import se3
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.sensors import span_lengths
from lmeasure.simulation import Leg, campaign_at, cell_rig, reference_poses, simulate_run, smooth_path


def machine(point: dict[str, Any], drum: dict[str, Any], phased: bool = False) -> Rig:
    """A cell whose second cable has these parts; phased: said of how they stand where the campaign begins."""
    plain = cell_rig(1)
    data = plain.to_dict()
    data["observation_point"][1].update(point)
    data["observation_point"][1]["drum"].update(drum)
    if phased:
        data["observation_point"][1]["phase_length_mm"] = float(span_lengths(plain, reference_poses()[:1])[0, 1])
    return rig_from_dict(data)


def calibrated(true: Rig, solve: tuple[str, ...], seed: int = 0) -> Calibration:
    made = campaign_at(
        true, reference_poses(), np.random.default_rng(seed), u_position_mm=0.005, nominal_shift_mm=3.0, nominal_shift_deg=0.5
    )
    campaign = Campaign(made.nominal, made.measured, true.cable, made.recorded, np.zeros(6, np.int64))
    return calibrate(campaign, CalibrationSettings(solve=("position", "guide", *solve)))


@pytest.mark.parametrize(
    ("point", "drum", "group", "size", "left_mm"),
    [
        ({}, {"run_out_mm": [0.04, 0.03]}, "run-out", 0.05, 0.02),
        ({"pulley_eccentricity_mm": [0.0, 0.05]}, {}, "eccentricity", 0.05, 0.02),
        ({}, {"backlash_counts": 3.0}, "backlash", 3.0, 0.06),
    ],
)
def test_what_a_machine_has_is_found_and_taken_off_runs_from_elsewhere(
    point: dict[str, Any], drum: dict[str, Any], group: str, size: float, left_mm: float
) -> None:
    found = calibrated(machine(point, drum), (f"{group}:B2",))
    (effect,) = found.record.effects
    assert effect.found
    assert effect.bits > 2.0
    assert abs(effect.value - size) < 4.0 * effect.u + 0.03 * size
    rng = np.random.default_rng(7)
    legs = [Leg(se3.pose(rng.uniform(-200, 200, 3), Rotation.from_rotvec(rng.uniform(-0.2, 0.2, 3)))) for _ in range(2)]
    time_s, path = smooth_path(np.array([120.0, -80.0, 60.0, 0, 0, 0, 1]), legs, 50.0)
    run = simulate_run(machine(point, drum, phased=True), time_s, path, noise_mm=0.0, rng=rng).run
    got = reconstruct(replace(run, rig=found.rig, calibration=found.record))
    error = se3.displacement(got.poses, path)
    assert (got.status == 0).all()
    assert np.linalg.norm(error[:, 3:], axis=1).max() < left_mm
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(got.random + got.systematic), error)
    # 0.1 and 99.9 % of six degrees of freedom
    assert 0.38 < np.median(square) < 22.5
    assert drum_variance(found.rig, found.record, path[:, :3], Rotation.identity(1), start=path[0]).max() < 0.06**2


def test_what_guides_and_points_make_up_for_is_said_to_be_undetermined() -> None:
    found = calibrated(machine({"swivel_offset_mm": 0.4, "swivel_tilt_deg": (0.3, 0.2)}, {}), ("offset:B2", "tilt:B2"))
    assert [e.effect for e in found.record.effects] == ["offset", "tilt"]
    assert not any(e.found or e.bits >= 1.0 for e in found.record.effects)
    assert any(w.code == "underdetermined" and w.text.startswith("B2") for w in found.record.warnings)


def test_nothing_is_found_where_there_is_nothing() -> None:
    """One campaign; the threshold is one in a hundred."""
    (effect,) = calibrated(cell_rig(1), ("run-out:B2",)).record.effects
    assert effect.probability > 0.01
    assert not effect.found
