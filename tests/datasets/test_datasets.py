"""Datasets hold what their manifests say, and the calibration folder made of one holds the same numbers."""

import hashlib
import tomllib
from pathlib import Path

import pytest

from lmeasure.rig import read_rig

ROOT = Path(__file__).parents[2]
MANIFESTS = sorted((ROOT / "datasets").glob("*/manifest.toml"))


def test_there_are_datasets() -> None:
    assert MANIFESTS


@pytest.mark.parametrize("path", MANIFESTS, ids=lambda p: p.parent.name)
def test_digests(path: Path) -> None:
    manifest = tomllib.loads(path.read_text())
    assert manifest["source"]
    names = {entry["name"] for entry in manifest["file"]}
    assert names == {p.name for p in path.parent.iterdir()} - {"manifest.toml", "README.md"}
    for entry in manifest["file"]:
        assert hashlib.sha256((path.parent / entry["name"]).read_bytes()).hexdigest() == entry["sha256"], entry["name"]


def test_the_calibration_folder_holds_the_published_numbers() -> None:
    for name in ("reference_poses.csv", "counts.csv"):
        assert (ROOT / "calibration/thesis-5.5" / name).read_bytes() == (ROOT / "datasets/thesis-5.5" / name).read_bytes()
    rig = tomllib.loads((ROOT / "calibration/thesis-5.5/rig.toml").read_text())
    points = {row[0]: [float(x) for x in row[1:]] for row in _rows("attachment_points.csv")}
    assert rig["tool"] == points
    refined = {row[0]: [float(x) for x in row[4:7]] for row in _rows("published_points.csv")}
    assert {p["name"]: p["position_mm"] for p in rig["observation_point"]} == refined


def _rows(name: str) -> list[list[str]]:
    return [line.split(",") for line in (ROOT / "datasets/thesis-5.5" / name).read_text().splitlines()[1:]]


def test_the_zones_rig_says_what_was_published() -> None:
    rig = read_rig(ROOT / "datasets/thesis-5.7/published.toml")
    # 5.6: three drums, three cables in a first cycle of the motion and three in a second
    assert len({c.channel for c in rig.cable}) == len(rig.observation_point) == 3
    assert [sum(c.passage == p for c in rig.cable) for p in (1, 2)] == [3, 3]
    refined = {row[0]: [float(x) for x in row[4:7]] for row in _rows("published_points.csv")}
    assert {p.name: list(p.position_mm) for p in rig.observation_point} == refined
    never = ("guide_alpha_deg", "guide_beta_deg", "pulley_radius_mm", "groove_pitch_mm", "tangent_length_mm", "axial_offset_mm")
    assert set(rig.assumed) == {f"{p.name}.{key}" for p in rig.observation_point for key in never}
