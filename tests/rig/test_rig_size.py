"""A rig that was written in metres or inches is named by whatever reads it, and used all the same; usual rigs are not."""

import copy
import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from in_process import ran, refused

from lmeasure.rig import unlikely_size
from lmeasure.templates import TEMPLATES, Answers, rig_of

ROOT = Path(__file__).parents[2]
RIGS = [
    path
    for folder in ("tests/authorities/truth", "calibration", "datasets")
    for path in sorted((ROOT / folder).rglob("*rig*.toml"))
    if "observation_point" in path.read_text(encoding="utf-8")
]
SMALL = {"metres": 1e-3, "inches": 1.0 / 25.4}


def in_unit(rig: dict[str, Any], factor: float) -> dict[str, Any]:
    """The same rig, every length in another unit."""
    out = copy.deepcopy(rig)

    def scaled(table: dict[str, Any]) -> None:
        for key, value in table.items():
            if isinstance(value, dict):
                scaled(value)
            elif key.endswith("_mm"):
                table[key] = [factor * v for v in value] if isinstance(value, list) else factor * value

    for point in out["observation_point"]:
        scaled(point)
    out["tool"] = {name: [factor * v for v in at] for name, at in out["tool"].items()}
    return out


@pytest.mark.parametrize("path", RIGS, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_rigs_that_are_there_are_of_a_usual_size_and_in_other_units_not(path: Path) -> None:
    rig = tomllib.loads(path.read_text(encoding="utf-8"))
    assert unlikely_size(rig, "rig.toml") is None
    for unit, factor in SMALL.items():
        found = unlikely_size(in_unit(rig, factor), "rig.toml")
        assert found is not None
        assert f"Dimensions are in millimetres. In {unit}, this would be" in str(found)
        assert found.text("ru") != found


@pytest.mark.parametrize("name", TEMPLATES)
def test_templates_are_of_a_usual_size(name: str) -> None:
    assert unlikely_size(rig_of(TEMPLATES[name], Answers()).model_dump(), "rig.toml") is None


def test_parts_in_metres_are_named_too() -> None:
    assert len(RIGS) > 3
    rig = tomllib.loads(RIGS[0].read_text(encoding="utf-8"))
    places = copy.deepcopy(rig)
    for point in places["observation_point"]:
        point["position_mm"] = [1e-3 * v for v in point["position_mm"]]
    assert "which is small for a cell" in str(unlikely_size(places, "rig.toml"))
    pulleys = copy.deepcopy(rig)
    for point in pulleys["observation_point"]:
        point["pulley_radius_mm"] = 0.02
    assert "all drum and pulley radii are at most 0.02 mm" in str(unlikely_size(pulleys, "rig.toml"))
    for strange in ({}, {"observation_point": 3}, {"observation_point": [{"position_mm": "x"}]}, {"observation_point": [3]}):
        assert unlikely_size(strange, "rig.toml") is None  # which its own checks say


@pytest.mark.parametrize(("unit", "factor"), SMALL.items())
def test_calibrate_says_in_which_unit_a_rig_was_written(unit: str, factor: float, tmp_path: Path) -> None:
    source = ROOT / "tests" / "authorities" / "truth" / "cell-12-poses"
    for path in source.iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    rig = tomllib.loads((source / "rig.toml").read_text(encoding="utf-8"))
    (tmp_path / "rig.toml").write_text(tomli_w.dumps(in_unit(rig, factor)), encoding="utf-8")
    first, second = refused("calibrate", tmp_path, "--out", tmp_path / "out").splitlines()[-2:]
    assert f"where the nominal rig's dimensions are {unit}, and not millimetres" in first
    assert f"In {unit}, this would be" in second
    assert not (tmp_path / "out").exists()


def test_a_rig_in_metres_is_used_and_named(tmp_path: Path) -> None:
    rig = in_unit(tomllib.loads(RIGS[0].read_text(encoding="utf-8")), 1e-3)
    (tmp_path / "rig.toml").write_text(tomli_w.dumps(rig), encoding="utf-8")
    words = ["drum", str(ROOT / "docs" / "nothing.toml"), "--rig", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "new.toml")]
    assert "In metres, this would be" in refused(*words).splitlines()[-1]
    # what people answer
    spans = ["my cell", *[""] * 40]
    assert "this would be" not in ran("init", tmp_path / "cell", typed="\n".join(["six-cables", *spans]))
