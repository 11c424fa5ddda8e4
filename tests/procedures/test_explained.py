"""What an ordinary run says of its rig: planted effects are named, chance and faults are not taken for one."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_process import ran
from scipy.spatial.transform import Rotation
from test_interim import HOME, calibrated, true_rig

from lmeasure.core import se3
from lmeasure.procedures import explained
from lmeasure.recording import Run, write_run
from lmeasure.rig import Rig, rig_from_dict, write_calibration_record, write_rig
from lmeasure.simulation import Leg, simulate_run, smooth_path
from lmeasure.text import Message
from lmeasure.trajectory import reconstruct

WORN: dict[str, tuple[str, dict[str, Any]]] = {
    "run_out": ("observation_point", {"drum": {"run_out_mm": [0.03, 0.03]}}),
    "eccentricity": ("observation_point", {"pulley_eccentricity_mm": [0.05, 0.03]}),
    "play": ("observation_point", {"drum": {"backlash_counts": 4.0}}),
    "encoder.eccentricity": ("swivel", {"eccentricity_deg": 0.02, "eccentricity_phase_deg": 40.0}),
}


def worn(kind: str) -> Rig:
    """The true rig with something that its drawing does not have, at B3."""
    data = true_rig().to_dict()
    table, keys = WORN[kind]
    for key, value in keys.items():
        owner = data[table][2]
        owner[key] = owner[key] | value if isinstance(value, dict) else value
    return rig_from_dict(data)


def run_of(true: Rig, seed: int, *, linked: bool = True, legs: int = 5) -> Run:
    """A run over drawn places by a rig that counts as the true one, read with the calibrated one, or with one that links nothing."""
    rng = np.random.default_rng([seed, 11])
    way = [
        Leg(se3.pose(rng.uniform(-250, 250, 3), Rotation.from_rotvec(rng.uniform(-0.25, 0.25, 3))), 800.0, 60.0, 0.1) for _ in range(legs)
    ]
    time_s, poses = smooth_path(HOME, way, 25.0)
    run = simulate_run(true, time_s, poses, noise_mm=0.0, rng=rng).run
    rig, record = calibrated()
    return replace(run, rig=rig, calibration=record) if linked else replace(run, rig=true_rig(), calibration=None)


def said(run: Run) -> list[Message]:
    return [note for note in reconstruct(run, judge=explained).notes if note.code.startswith("effects.named")]


@pytest.mark.parametrize("kind", WORN)
def test_a_planted_effect_is_named_with_its_size(kind: str) -> None:
    (found,) = said(run_of(worn(kind), 5))
    first = found.values["laws"][0]
    assert first.code == f"effect.{kind}"
    assert first.values["channel"] == ("sw3" if kind.startswith("encoder") else "ch3")
    size = {"run_out": 0.0424, "eccentricity": 0.0583, "play": 4.0, "encoder.eccentricity": 0.02}[kind]
    assert 0.7 * size < first.values["size"] < 1.5 * size
    assert found.values["p"] < 1e-6


@pytest.mark.parametrize("linked", [True, False])
def test_chance_is_seldom_taken_for_an_effect(linked: bool) -> None:
    """Of 10 sound runs, stated one in a hundred: two would be four chances in a thousand."""
    assert sum(bool(said(run_of(true_rig(), seed, linked=linked, legs=3))) for seed in range(10)) <= 1


def test_counts_that_were_lost_are_no_effect() -> None:
    run = run_of(true_rig(), 3)
    counts = run.passes[0].recorded.copy()
    counts[40:, 1] += 12.0
    assert not said(replace(run, passes=(replace(run.passes[0], recorded=counts),)))


def test_summary_and_page_say_it(tmp_path: Path) -> None:
    run = run_of(worn("run_out"), 5)
    write_run(tmp_path / "run", run)
    rig, record = calibrated()
    write_rig(tmp_path / "run" / "rig.toml", rig)
    write_calibration_record(tmp_path / "run" / "calibration.json", record)
    reported = ran("reconstruct", tmp_path / "run", "--out", tmp_path / "t.parquet")
    assert "run-out of the drum of ch3 (0.0" in " ".join(reported.split())
    assert "--solve run-out:B3" in " ".join(reported.split())
    ran("report", tmp_path / "run", "--out", tmp_path / "page", "--language", "ru")
    assert "биение барабана, ch3 (0,0" in (tmp_path / "page" / "trajectory.html").read_text(encoding="utf-8")
