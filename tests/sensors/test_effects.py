"""Rigs with temperature, stretch and sag: their keys, their runs and calibrations from counts that have the effects in them."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from zeroed import exactly

from lmeasure.calibration import CalibrationSettings, calibrate, read_campaign
from lmeasure.core import FileFormatError, FloatArray, GeometryError, RigError
from lmeasure.recording import Counts, Run, read_run, read_run_head, write_run
from lmeasure.rig import Rig, rig_from_dict, write_rig
from lmeasure.sensors import counts_from_poses, effects_of, length_residuals, span_lengths
from lmeasure.simulation import Leg, cell_rig, read_scenario, simulate, simulate_run, smooth_path, write_simulated
from lmeasure.trajectory import read_trajectory, reconstruct, reconstruct_stream

CABLE: dict[str, float] = {
    "cable_expansion_per_k": -1.2e-5, "drum_expansion_per_k": 2.3e-5, "guide_length_mm": 300.0, "cable_stiffness_n": 9000.0,
    "cable_mass_kg_per_m": 0.001, "cable_tension_n": 6.0, "cable_tension_n_per_m": 0.5,
}  # fmt: skip
FRAME: dict[str, float] = {"frame_expansion_per_k": 1.2e-5}
START = np.array([0.0, 0, 0, 0, 0, 0, 1])
LEGS = [
    Leg(np.array([200.0, -150, 100, 0, 0, math.sin(0.1), math.cos(0.1)])),
    Leg(np.array([-200.0, 150, -100, 0.1, 0, 0, math.sqrt(0.99)])),
]


def rig_with(cable: dict[str, float] | None = None, frame: dict[str, float] | None = None) -> Rig:
    data: dict[str, Any] = cell_rig(1).to_dict() | (frame or {})
    for point in data["observation_point"]:
        point["drum"] |= cable or {}
    return rig_from_dict(data)


def exact_run(rig: Rig, rise: float = 5.0) -> tuple[Run, FloatArray]:
    """Counts that are not rounded, while it gets warmer."""
    time_s, poses = smooth_path(START, LEGS, 50.0)
    warm = 22.0 + rise * time_s / time_s[-1]
    counts = counts_from_poses(rig, poses, START, None, temperature_c=warm, zero_temperature_c=22.0)
    return Run(rig, START, (Counts(time_s, rig.channels, counts, temperature_c=warm),), temperature_c=22.0, unstated="exact"), poses


def errors(run: Run, poses: FloatArray, **given: Any) -> float:
    return float(np.abs(reconstruct(run, **given).poses[:, :3] - poses[:, :3]).max())


def test_a_rig_without_keys_has_no_effects_and_the_same_file() -> None:
    assert effects_of(cell_rig(1)) is None
    assert effects_of(rig_with(frame={"u_temperature_k": 0.5, "reference_temperature_c": 23.0})) is None
    assert not any(key.startswith(("cable_", "frame_", "u_")) for key in cell_rig(1).to_dict()["observation_point"][0]["drum"])


@pytest.mark.parametrize(
    ("cable", "text"),
    [
        ({"cable_stiffness_n": 9e3}, "cable_stiffness_n: has an effect only with cable_tension_n, which is missing"),
        ({"cable_mass_kg_per_m": 1e-3}, "cable_mass_kg_per_m: has an effect only with cable_tension_n"),
        ({"cable_tension_n": 5.0, "winding_tension_n": 3.0}, "winding_tension_n: has an effect only with cable_stiffness_n"),
        ({"u_cable_expansion_per_k": 1e-6}, "u_cable_expansion_per_k: is the uncertainty of cable_expansion_per_k"),
        ({"cable_tension_n": -5.0}, "cable_tension_n: must be positive"),
        ({"cable_expansion_per_k": 12.0}, "cable_expansion_per_k: must be at most 0.001"),
        ({"cable_expansion": 1e-5}, "unknown key 'cable_expansion'. Did you mean 'cable_expansion_per_k'"),
        ({"cable_tension_n": 5.0, "u_cable_tension_n": 3.0}, "u_cable_tension_n: 3 is more than half of cable_tension_n, 5"),
        ({"u_cable_tension_change_n": 0.1}, "u_cable_tension_change_n: has an effect only with cable_stiffness_n"),
    ],
)
def test_keys_that_cannot_be(cable: dict[str, float], text: str) -> None:
    with pytest.raises(RigError, match=text) as error:
        rig_with(cable)
    assert "[observation_point B1].drum" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "keys",
    [
        {"cable_expansion_per_k": 1.6e-5},
        {"drum_expansion_per_k": 2.3e-5},
        {"cable_tension_n": 6.0, "cable_stiffness_n": 9000.0, "cable_tension_n_per_m": 0.5},
        {"cable_tension_n": 6.0, "cable_stiffness_n": 9000.0, "winding_tension_n": 3.0},
        {"cable_tension_n": 6.0, "cable_mass_kg_per_m": 0.004},
        CABLE,
    ],
    ids=lambda k: "-".join(k)[:40],
)
def test_a_run_with_effects_is_reconstructed_exactly_and_not_without(keys: dict[str, float]) -> None:
    run, poses = exact_run(rig_with(keys, FRAME if keys is CABLE else None))
    assert errors(run, poses) < 1e-9
    assert np.abs(length_residuals(run, poses)).max() < 1e-9
    plain = Run(cell_rig(1), START, run.passes, unstated="exact")
    assert errors(plain, poses) > (1e-3 if "cable_mass_kg_per_m" in keys else 5e-3)


def test_a_constant_tension_alone_changes_nothing() -> None:
    """What is wound has the strain of what is free."""
    run, poses = exact_run(rig_with({"cable_tension_n": 6.0, "cable_stiffness_n": 9000.0}))
    plain = Run(cell_rig(1), START, run.passes, unstated="exact")
    assert errors(plain, poses) < 1e-9


def test_error_of_leaving_out_expansion_is_that_of_the_cable_s_length() -> None:
    run, poses = exact_run(rig_with({"cable_expansion_per_k": 1.6e-5}))
    end = reconstruct(Run(cell_rig(1), START, run.passes, unstated="exact"))
    left = length_residuals(Run(cell_rig(1), START, run.passes, unstated="exact"), poses)[-1]
    rows = cell_rig(1).cable_rows()
    free = span_lengths(cell_rig(1), poses[-1:])[0] + np.hypot(rows[:, 10], rows[:, 11])
    # five kelvin more than at the start: the same counts hold more cable
    assert left == pytest.approx(-1.6e-5 * 5 * free, rel=0.1)
    assert 0.02 < np.linalg.norm(end.poses[-1, :3] - poses[-1, :3]) < 1.0


def test_streamed_in_pieces_it_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = rig_with(CABLE, FRAME)
    time_s, poses = smooth_path(START, LEGS, 200.0)
    simulated = simulate_run(rig, time_s, poses, noise_mm=0.0, rng=np.random.default_rng(0), temperature_c=22.0 + 5 * time_s / time_s[-1])
    write_run(tmp_path / "run", simulated.run)
    run = read_run(tmp_path / "run")
    assert run.temperature_c == 22.0
    whole = reconstruct(run)
    monkeypatch.setattr("lmeasure.io.tables.PIECE_BYTES", 4096)
    reconstruct_stream(read_run_head(tmp_path / "run"), tmp_path / "t.parquet")
    assert read_trajectory(tmp_path / "t.parquet").poses == pytest.approx(whole.poses, abs=1e-9)
    assert np.abs(whole.poses[:, :3] - poses[:, :3]).max() < 0.03


def test_uncertainty_of_effects_is_that_of_drawn_rigs() -> None:
    """The stated systematic part against runs whose true coefficients are drawn, reconstructed with the nominal ones."""
    uncertain = {"u_cable_expansion_per_k": 3e-6, "u_cable_stiffness_n": 900.0, "u_cable_tension_n": 0.5, "u_cable_mass_kg_per_m": 2e-4}
    stated = rig_with(CABLE | uncertain, FRAME | {"u_frame_expansion_per_k": 2e-6})
    run, poses = exact_run(stated)
    u = np.sqrt(np.einsum("nii->ni", reconstruct(run).systematic))[-1]
    rng = np.random.default_rng(5)
    found = []
    for _ in range(40):
        data = rig_with(CABLE, {"frame_expansion_per_k": 1.2e-5 + 2e-6 * rng.normal()}).to_dict()
        for point in data["observation_point"]:
            for key, width in uncertain.items():
                point["drum"][key.removeprefix("u_")] += width * float(np.clip(rng.normal(), -2.5, 2.5))
        true, _ = exact_run(rig_from_dict(data))
        last = Counts(run.passes[0].time_s, stated.channels, true.passes[0].recorded, temperature_c=run.passes[0].temperature_c)
        found.append(reconstruct(Run(stated, START, (last,), temperature_c=22.0, unstated="exact")).poses[-1, :3] - poses[-1, :3])
    assert np.std(found, axis=0) / u[3:] == pytest.approx(1.0, abs=0.3)
    mc = reconstruct(run, trials=100)
    assert np.sqrt(np.einsum("nii->ni", mc.systematic))[-1] / u == pytest.approx(1.0, abs=0.25)


def test_temperature_and_friction_are_in_the_uncertainty() -> None:
    run, _ = exact_run(exactly(rig_with(CABLE, FRAME)))
    assert reconstruct(run).systematic.max() == 0.0
    for more in ({"u_temperature_k": 0.5}, {}):
        friction = {} if more else {"u_cable_tension_change_n": 0.1}
        run, _ = exact_run(rig_with(CABLE | friction, FRAME | more))
        assert 1e-3 < float(reconstruct(run).u[-1, 0]) < 0.5


def test_a_run_that_states_no_temperature_says_so() -> None:
    run, _ = exact_run(rig_with(CABLE, FRAME), rise=0.0)
    silent = Run(run.rig, START, (Counts(run.passes[0].time_s, run.rig.channels, run.passes[0].recorded),), unstated="exact")
    assert any("no temperature is stated. The rig's reference of 20 deg C is used" in note for note in map(str, reconstruct(silent).notes))


def test_a_drum_whose_spring_runs_out_is_refused() -> None:
    rig = rig_with(CABLE | {"cable_tension_n": 0.05, "cable_tension_n_per_m": -1.0})
    with pytest.raises(GeometryError, match=r"cable c\d: with -?[\d.e-]+ N it does not carry itself") as error:
        exact_run(rig)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("value", "text"), [('"warm"', "must be a number"), ("400", "between -100 and 200"), ("true", "must be a number")])
def test_temperatures_of_a_run_that_cannot_be(tmp_path: Path, value: str, text: str) -> None:
    run, _ = exact_run(cell_rig(1))
    write_run(tmp_path, run)
    path = tmp_path / "run.toml"
    path.write_text(path.read_text().replace("temperature_c = 22.0", f"temperature_c = {value}"))
    with pytest.raises(FileFormatError, match=text):
        read_run(tmp_path)


def campaign_folder(tmp_path: Path, extra: str = "", frame: dict[str, float] | None = None) -> Path:
    write_rig(tmp_path / "cell.toml", rig_with(CABLE, FRAME | (frame or {})))
    (tmp_path / "scenario.toml").write_text(
        'schema = "lmeasure.scenario/1"\nrig = "cell.toml"\ntemperature_c = 21.0\nend_temperature_c = 27.0\n'
        f"[reference_poses]\ncount = 16\nnominal_shift_mm = 10.0\nnominal_shift_deg = 2.0\n{extra}"
    )
    write_simulated(tmp_path, simulate(*read_scenario(tmp_path / "scenario.toml")))
    return tmp_path / "calibration"


def test_a_calibration_while_it_gets_warmer(tmp_path: Path) -> None:
    """With the effects in the rig the fit is as good as counts allow; a rig without them cannot explain the counts, and says so."""
    folder = campaign_folder(tmp_path)
    campaign = read_campaign(folder)
    assert campaign.temperature_c == pytest.approx(np.tile(np.linspace(21, 27, 16)[:, None], len(campaign.cables)))
    good = calibrate(campaign, CalibrationSettings())
    assert good.record.noise["residual_rms_mm"] < 0.0045
    assert not [w for w in good.record.warnings if w.code == "misfit"]
    assert good.rig.observation_point[0].drum.cable_tension_n == 6.0
    (folder / "rig.toml").write_text(
        "\n".join(
            line
            for line in (folder / "rig.toml").read_text().splitlines()
            if not line.startswith(("cable_", "drum_exp", "guide_length", "frame_"))
        )
    )
    assert effects_of(read_campaign(folder).rig) is None
    assert [w for w in calibrate(read_campaign(folder), CalibrationSettings()).record.warnings if w.code == "misfit"]


def test_uncertain_temperatures_enter_the_calibration(tmp_path: Path) -> None:
    sure = calibrate(read_campaign(campaign_folder(tmp_path / "a")), CalibrationSettings()).record
    unsure = calibrate(read_campaign(campaign_folder(tmp_path / "b", frame={"u_temperature_k": 1.0})), CalibrationSettings()).record
    assert sum(p.u for p in unsure.parameters) > 1.1 * sum(p.u for p in sure.parameters)
    assert unsure.noise["chi_squared"] < sure.noise["chi_squared"]
