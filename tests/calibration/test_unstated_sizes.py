"""Rigs that state nothing: residuals show the sizes of their errors. The simulator of benchmarks/unstated.py shares no code with us."""

import importlib
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import scipy.stats

from lmeasure.calibration import CalibrationSettings, calibrate, read_campaign
from lmeasure.core import FileFormatError
from lmeasure.estimation import sizes
from lmeasure.rig import rig_from_dict
from lmeasure.sensors import counts_from_poses

ROOT = Path(__file__).parents[2]
TRUTH = ROOT / "tests" / "authorities" / "truth"


@pytest.fixture(scope="module")
def study() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "benchmarks")
        yield importlib.import_module("unstated")


def test_the_simulator_has_the_law_of_the_rig(study: ModuleType) -> None:
    """Two independent statements of wrap, helix, run-out, eccentricity and offset agree to whole counts."""
    world = study.World({key: study.SIZES[key] for key in ("u_run_out_mm", "u_pulley_eccentricity_mm", "u_swivel_offset_mm")})
    b = study.bench(3, world)
    for point, drum in zip(b.nominal["observation_point"], b.drums, strict=True):
        point["position_mm"] = drum.place.tolist()
        point["guide_alpha_deg"], point["guide_beta_deg"] = math.degrees(drum.alpha), math.degrees(drum.beta)
        point["pulley_eccentricity_mm"], point["swivel_offset_mm"] = drum.eccentric.tolist(), drum.offset
        point["drum"]["run_out_mm"] = drum.run_out.tolist()
    rows = study._pose_rows(b.reference)
    whole = study.counted(b, b.reference, world, 3, run=False)
    # a phase within one count, and rounding; the eccentricity turns the pulley by x/R, which the law leaves out
    assert np.abs(whole - counts_from_poses(rig_from_dict(b.nominal), rows, rows[0])).max() < 1.2


@pytest.mark.parametrize(
    ("world", "mode", "error_mm", "u_mm", "said"),
    [
        ("sound", "unstated", 0.03, 0.05, ""),
        ("attachments 2 mm", "unstated", 0.05, 0.08, "larger"),
        ("attachments 2 mm", "stated", 0.06, 0.15, "misfit"),
        ("a typing error of 10 mm", "unstated", 0.03, 0.05, "outlier"),
        ("a point moves 1 mm", "unstated", 0.03, 0.05, ""),
        ("robot 0.3 mm, 20 poses", "unstated", 0.13, 0.2, ""),
        ("friction 30 counts", "stated", 0.95, 0.8, "misfit"),
    ],
)
def test_sizes_are_estimated(study: ModuleType, world: str, mode: str, error_mm: float, u_mm: float, said: str) -> None:
    """Errors of a later motion are as small as with known sizes, and within U95. Stated sizes of broken worlds are typical."""
    got = study.draw(2 if "robot" in world else 1, world, mode)
    assert got["error_mm"] < error_mm
    assert got["u_mm"] < u_mm
    assert got["inside"] >= 0.93
    assert set(got["codes"]) & {"outlier", "larger", "effect", "misfit"} == {said} - {""}


@pytest.mark.parametrize(
    ("world", "seed", "said"),
    [
        ("a point moves 1 mm", 0, "B3 moved by about 1.2 mm"),
        ("circumferences 0.2 %", 1, "B3"),
        ("sound", 0, ""),
        ("robot 1 mm, 20 poses", 2, ""),
    ],
)
def test_faults_beyond_typical_sizes_are_named(study: ModuleType, tmp_path: Path, world: str, seed: int, said: str) -> None:
    study.folder(tmp_path, study.bench(seed, study.WORLDS[world]), study.WORLDS[world], seed, "unstated")
    found = [w for w in calibrate(read_campaign(tmp_path)).record.warnings if w.code in ("moved", "larger", "slip", "outlier", "misfit")]
    assert len(found) == bool(said)
    assert all(said in str(one.text) for one in found)


def test_chosen_unknowns_have_the_mean_over_sizes_too(study: ModuleType, tmp_path: Path) -> None:
    """The default unknowns by name have the values that they have by default; what is not to move keeps its nominal value."""
    world = study.WORLDS["typical, 12 poses"]
    study.folder(tmp_path, study.bench(2, world), world, 2, "unstated")
    campaign = read_campaign(tmp_path)
    every, some = calibrate(campaign), calibrate(campaign, CalibrationSettings(solve=("position", "guide")))
    assert [p.value for p in some.record.parameters] == pytest.approx([p.value for p in every.record.parameters], rel=1e-9)
    assert some.rig.tool == campaign.rig.tool != every.rig.tool


def test_sizes_are_those_of_a_brute_force_posterior() -> None:
    rng = np.random.default_rng(5)
    J, F = rng.normal(size=(24, 4)), rng.normal(size=(24, 12))
    r = 2.0 * F @ rng.normal(size=12) + 0.5 * rng.normal(size=24) + J @ rng.normal(size=4)
    V, A = 0.25 * np.eye(24), F @ F.T
    N = np.linalg.svd(J)[0][:, 4:]
    x = np.linspace(-4.0, 4.0, 801)
    log_p = np.array([scipy.stats.multivariate_normal(cov=N.T @ (V + np.exp(2 * v) * A) @ N).logpdf(N.T @ r) for v in x])
    # modulus of Student's t of four degrees of freedom, whose variance is 2
    p = np.exp(log_p - log_p.max()) * scipy.stats.t(4).pdf(np.sqrt(2.0) * np.exp(x)) * np.exp(x)
    p /= p.sum()
    found = sizes(r, J, V, [A], sweeps=400)
    assert np.mean(np.log(found.draws[:, 0])) == pytest.approx(p @ x, abs=0.08)
    assert found.size[0] == pytest.approx(np.sqrt(p @ np.exp(2 * x)), rel=0.1)


def test_exact_rigs_have_the_results_that_they_had() -> None:
    """Figures of the solver before sizes were estimated."""
    campaign = read_campaign(TRUTH / "cell-20-poses-noisy")
    found = calibrate(replace(campaign, poses=campaign.poses.with_uncertainty(0.05, 0.0))).record
    assert [p.value for p in found.parameters[:2]] == pytest.approx([-754.2014894207, 292.9195604360], rel=1e-10)
    assert not found.warnings


def test_references_name_one_source(tmp_path: Path) -> None:
    for name in ("rig.toml", "counts.csv", "reference_poses.csv"):
        (tmp_path / name).write_bytes((TRUTH / "cell-12-poses" / name).read_bytes())
    path = tmp_path / "reference_poses.csv"
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head + ",reference", *(row + ",robot" for row in rows)]))
    assert read_campaign(tmp_path).source == "robot"
    path.write_text("\n".join([head + ",reference", *(row + ",robot" for row in rows[:-1]), rows[-1] + ",laser"]))
    with pytest.raises(FileFormatError, match=r"'robot', 'laser'. Write one of tracker, robot, unknown in every row"):
        read_campaign(tmp_path)
