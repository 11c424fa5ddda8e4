"""Rigs to begin with: they load, serve their cube, say rightly what an error costs, and the whole way from an empty folder works."""

import json
import re
import shlex
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from in_process import ran, refused
from reference.rig_channels import cable_lengths
from reference.solver import pressure_angles, solve_poses, twists
from scipy.spatial.transform import Rotation

from lmeasure.accuracy import read_zone
from lmeasure.core import CONVENTIONS, se3
from lmeasure.io import read_toml
from lmeasure.rig import Drum, ObservationPoint, Rig, read_calibration_record, read_rig, value_of, with_values
from lmeasure.sensors import counts_from_poses
from lmeasure.templates import TEMPLATES, Answers, folder_files, rig_of
from lmeasure.templates.files import box_poses, costs, position_errors

START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def moved(rig: Rig, true: Rig, poses: np.ndarray) -> np.ndarray:
    """(n, 3) how far off the tool is measured by the rig's file, when the instrument is the true one: its counts, solved."""
    recorded, channels = counts_from_poses(true, poses, START) * true.scales(), cable_lengths(rig, START)
    found = solve_poses(channels, np.column_stack([c.readings(k) for c, k in zip(channels, recorded.T, strict=True)]), poses)
    return np.asarray(found.poses[:, :3] - poses[:, :3])


@pytest.mark.parametrize("name", TEMPLATES)
def test_what_an_error_costs_by_solving_with_a_wrong_file(name: str) -> None:
    """Readings of the rig as it is, solved by a file that is wrong by a small step: no derivative is used."""
    rig = rig_of(TEMPLATES[name])
    r = np.random.default_rng(3)
    poses = se3.pose(r.uniform(-300, 300, (12, 3)), Rotation.from_rotvec(r.uniform(-0.2, 0.2, (12, 3))))
    names: tuple[str, ...] = (
        "B1.x_mm", "B2.z_mm", "B1.guide_alpha_deg", "B3.guide_beta_deg", "B2.pulley_radius_mm", "B1.tangent_length_mm",
    )  # fmt: skip
    names += ("B3.axial_offset_mm", "B1.groove_pitch_mm", "B2.scale", "tool.P1.y_mm")
    linear = position_errors(rig, START, poses, names)
    for i, one in enumerate(names):
        step = 1e-4 if one.endswith("scale") else 0.02
        value = value_of(rig, one)
        assert value is not None
        sides = [moved(with_values(rig, {one: value + s}), rig, poses) for s in (step, -step)]
        slope = (sides[0] - sides[1]) / (2 * step)
        assert slope == pytest.approx(linear[:, :, i], abs=2e-3 * np.abs(linear[:, :, i]).max()), one


def test_the_cost_is_the_worst_of_the_box_and_of_all_directions() -> None:
    rig = rig_of(TEMPLATES["six-cables"])
    reported, box = costs(rig), box_poses()
    errors = position_errors(rig, START, box, ("B2.x_mm", "B2.y_mm", "B2.z_mm"))
    r = np.random.default_rng(1)
    directions = r.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    largest = np.linalg.norm(np.einsum("nij,dj->ndi", errors, directions), axis=2).max()
    assert largest <= reported["B2.position_mm"].mm
    assert largest == pytest.approx(reported["B2.position_mm"].mm, rel=0.01)


@pytest.mark.parametrize("name", TEMPLATES)
def test_every_template_is_whole_and_serves_its_cube(name: str, tmp_path: Path) -> None:
    ran("init", tmp_path, "--template", name)
    rig = read_rig(tmp_path / "rig.toml")
    assert rig == rig_of(TEMPLATES[name]), "what is written is what the costs were worked out for"
    rig.require_pose(redundant=True)
    channels, box = cable_lengths(rig, START), box_poses()
    assert np.degrees(pressure_angles(channels, box, twists(channels, box)).max()) < 80
    for kind in ("rig", "drums", "placement", "scenario"):
        content = read_toml(tmp_path / f"{kind}.toml")
        jsonschema.validate(content, json.loads((tmp_path / "schemas" / f"{kind}.json").read_text()))
        assert content.text.startswith(f"#:schema schemas/{kind}.json\n")
    # every dimension of the first point is explained, every one of all costs something that is said
    text = (tmp_path / "rig.toml").read_text(encoding="utf-8")
    first = text[text.index("[[observation_point]]") : text.index('name = "B2"')]
    for key in (*ObservationPoint.model_fields, *Drum.model_fields):
        if re.search(rf"^{key} = ", first, re.MULTILINE) and key not in ("name", "count_sign"):
            assert re.search(rf"^# .*\n{key} = ", first, re.MULTILINE), key
    assert len(re.findall(r"# error of [\d.]+ (?:mm|deg|%): up to \d", text)) == len(rig.observation_point) * 8 + len(rig.tool)
    assert max(map(len, text.splitlines())) < 150


def test_nothing_is_ever_written_over(tmp_path: Path) -> None:
    (tmp_path / "drums.toml").write_text("mine")
    assert "drums.toml: exists" in refused("init", tmp_path, "--template", "six-cables", code=2)
    assert [p.name for p in tmp_path.iterdir()] == ["drums.toml"]
    one = tmp_path / "one.toml"
    ran("init", one, "--template", "three-drums")
    text = one.read_text()
    assert "#:schema" not in text
    refused("init", one, "--template", "six-cables", code=2)
    assert one.read_text() == text
    assert (tmp_path / "drums.toml").read_text() == "mine"


def test_questions_are_asked_where_no_template_is_named(tmp_path: Path) -> None:
    answers = [
        "four", "three-drums", "cell 7", "kuka-abc", "4096", "0.02", "x", "1.5", "22.5", "", "100,200,300", "1,2", "7,8,9", *[""] * 9,
    ]  # fmt: skip
    made = ran("init", tmp_path, typed="\n".join(answers))
    assert "'four' is not in the list. Which" in made
    assert "'x' is not a number" in made
    assert "'1,2' is not 3 numbers" in made
    rig = read_rig(tmp_path / "rig.toml")
    assert (rig.name, rig.angles, rig.point("B1").drum.counts_per_revolution) == ("cell 7", "kuka-abc", 4096)
    assert rig.point("B3").pulley_radius_mm == 22.5
    assert rig.point("B1").position_mm == TEMPLATES["three-drums"].points[0]
    assert rig.point("B2").position_mm == (100.0, 200.0, 300.0)
    assert rig.point("B3").position_mm == (7.0, 8.0, 9.0)
    assert "B1.pulley_radius_mm" not in rig.assumed, "it was said"
    assert "B1.tangent_length_mm" in rig.assumed
    refused("init", tmp_path / "other", code=2)
    refused("init", tmp_path / "other", "--template", "nine", code=2)
    assert not (tmp_path / "other").exists()
    assert len(ran("init", "--list").splitlines()) == len(TEMPLATES) + 1  # and the command to type next


def test_numbers_that_make_no_rig_are_asked_for_again(tmp_path: Path) -> None:
    """One at a time: all answers were lost by one that was wrong. An encoder of 24 bits is no mistake."""
    answers = ["", "", "", "0", "16777216", "0", "-0.01", "0.001", "", "-3", "nan", "20", "2e6,0,0", *[""] * 10]
    made = ran("init", tmp_path, typed="\n".join(answers))
    for error in (
        "'0' must be at least 1.",
        "'0' must be at least 1e-09.",
        "'-0.01' must be",
        "'-3' must be at least 0.",
        "'nan' is not a number",
    ):
        assert error in made
    assert "'2e6,0,0' must be at most 1000000." in made
    assert read_rig(tmp_path / "rig.toml").point("B1").drum.counts_per_revolution == 16777216


def test_questions_are_russian_where_the_terminal_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LANGUAGE", "ru")
    answers = ["four", "", "", "", "6000.5", "", "0,012", "", "", "-1", "", "1,2", *[""] * 12]
    made = ran("init", tmp_path, typed="\n".join(answers))
    requested = made.partition(str(tmp_path))[0]
    words = set(re.findall("[A-Za-z]{3,}", requested))
    assert words == set(re.findall("[A-Za-z]{3,}", f"four my rig Enter {' '.join(TEMPLATES)} {' '.join(CONVENTIONS)}")), words
    assert "[0.012]: '0,012' – не число. " in requested  # as it may be typed


def test_what_is_said_to_come_next_can_be_pasted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LANGUAGE", "ru")
    reported = ran("init", tmp_path / "моя ячейка", "--template", "three-drums")
    assert f"{tmp_path / 'моя ячейка' / 'rig.toml'}: три барабана, " in reported
    command = re.search("^дальше: lmeasure (.*)$", reported, re.MULTILINE)
    assert command is not None
    ran(*shlex.split(command[1]))
    assert (tmp_path / "моя ячейка" / "measured.toml").is_file()


def test_from_an_empty_folder_to_a_placed_zone(tmp_path: Path) -> None:
    """The mechanic's way without a file written by hand: init, drums, a simulated campaign, calibrated, zone, place."""

    def done(*words: str) -> str:
        return ran(*([word.replace("@", f"{tmp_path}/") for word in words]))

    done("init", "@", "--template", "six-cables")
    done("drum", "@drums.toml", "--rig", "@rig.toml", "--out", "@measured.toml")
    measured = read_rig(tmp_path / "measured.toml")
    assert measured.assumed == tuple(f"B{i}.pulley_radius_mm" for i in range(1, 7))
    assert "# error of 1 mm: up to" in (tmp_path / "measured.toml").read_text(), "what was explained stays so"
    text = (tmp_path / "scenario.toml").read_text()
    (tmp_path / "scenario.toml").write_text(text.replace('rig = "rig.toml"', 'rig = "measured.toml"'))
    done("simulate", "@scenario.toml", "--out", "@tried")
    assert "rank" in done("calibrate", "@tried/calibration", "--out", "@calibrated")
    record = read_calibration_record(tmp_path / "calibrated" / "calibration.json")
    assert not [w.code for w in record.warnings if w.code in ("sign", "swapped", "scale", "edge", "outlier")]
    reported = done("zone", "@calibrated/rig.toml", "--tilt-rad", "0.1", "--out", "@zone.nc")
    assert re.search(r"The box is --x \S+ --y \S+ --z \S+, around the rig", reported)
    assert int(read_zone(tmp_path / "zone.nc")["in_zone"].sum()) > 0
    # a smaller task than the one that comes along takes a fraction of its time
    text = (tmp_path / "placement.toml").read_text()
    (tmp_path / "placement.toml").write_text(text.replace("tilt_steps = 3", "tilt_steps = 1").replace("nodes = 3", "nodes = 2"))
    reported = done("place", "@calibrated/rig.toml", "--task", "@placement.toml", "--out", "@placed", "--generations", "5")
    before, after = map(float, re.findall(r"worst pressure angle in the task ([\d.]+) -> ([\d.]+) deg", reported)[0])
    assert after < before


def test_answers_that_make_no_rig_are_refused() -> None:
    assert folder_files(rig_of(TEMPLATES["six-cables"], Answers(name='a "b"')), "x")["rig.toml"].count('name = "a \\"b\\""') == 1
