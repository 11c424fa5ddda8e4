"""What a command is asked: every option is explained once, ranges are refused in one line, and defaults are those of the stages."""

from pathlib import Path
from typing import Any

import pytest

from lmeasure.accuracy import GENERATIONS, Limits
from lmeasure.acquisition import log_suffixes
from lmeasure.calibration import CalibrationSettings
from lmeasure.calibration.plan import pose_choice, reach
from lmeasure.core import SettingsError
from lmeasure.estimation import CRITERIA
from lmeasure.iso9283 import CertificationSettings, Tests as CubeTests
from lmeasure.report import Choices
from lmeasure.robot_programs import dialect_names
from lmeasure.text import LANGUAGES
from lmeasure.workflows import COMMANDS, load, options_of, rows_of_numbers, said_of, with_commas
from lmeasure.workflows.settings import Separated, Spans, Words, unit_of

HERE = Path("here")
GIVEN: dict[str, dict[str, Any]] = {
    "calibrate": {"folder": HERE, "out": HERE},
    "zone": {"rig": HERE, "x": "0:1:1", "y": (0.0, 1.0, 1.0), "z": "0:1:1", "out": HERE},
    "plan-poses": {"rig": HERE, "poses": 4, "out": HERE},
    "certify": {"trajectory": HERE, "program": HERE, "out": HERE},
    "program": {"out": HERE},
    "import": {"logs": (HERE,), "rig": HERE, "out": HERE},
    "record": {"rig": HERE, "bus": "virtual:a", "out": HERE},
    "motion": {"trajectory": HERE, "out": HERE},
    "place": {"rig": HERE, "task": HERE, "out": HERE},
}


def requested(command: str, **more: Any) -> Any:
    return load(command).settings(**GIVEN[command] | more)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_form_can_be_made_of_every_command(command: str) -> None:
    """Its schema tells help, unit and range of each option; nothing in it is of this program's own types."""
    _, text, model, _ = load(command)
    assert text.endswith(".")
    schema = model.model_json_schema()
    assert set(schema["properties"]) == set(model.model_fields)
    for name, reported in schema["properties"].items():
        assert reported["description"], name
        field = model.model_fields[name]
        # a number of something says of what
        if field.annotation in (float, float | None) and name not in {"capability", "refine", "singularity"}:
            assert unit_of(name, field), f"{command} {name}"


def test_units_and_ranges_are_told_also_where_the_stage_checks_them() -> None:
    reported = load("zone").settings.model_json_schema()["properties"]
    assert reported["limit_deg"]["maximum"] == 90.0
    assert reported["x"]["unit"] == "mm"
    assert unit_of("limit_deg", load("zone").settings.model_fields["limit_deg"]) == "deg"
    assert said_of(load("zone").settings.model_fields["limit_deg"])["panel"] == "Limits"


@pytest.mark.parametrize(
    ("command", "wrong", "line"),
    [
        ("calibrate", {"neighbourhood_mm": 0.0}, "neighbourhood_mm: must be at least 0.001, is 0.0"),
        ("calibrate", {"frame": "robot"}, "frame: 'robot' is not one of rig, poses"),
        ("calibrate", {"rerun": Path("a.txt")}, "rerun: 'a.txt' does not end in .rrd"),
        ("calibrate", {"sead": 1}, "sead: unknown key 'sead'. Did you mean 'seed'?"),
        ("plan-poses", {"poses": 0}, "poses: must be at least 1, is 0"),
        ("plan-poses", {"box": "0:1,0:1"}, "box: '0:1,0:1' is not X0:X1,Y0:Y1,Z0:Z1"),
        ("plan-poses", {"passes": "1,x"}, "passes: '1,x' is not some whole numbers with ',' or a blank between them"),
        ("zone", {"x": "0:1"}, "x: '0:1' is not three numbers with ':' between them"),
        ("zone", {"quaternion": (1.0, 1.0, 0.0, 0.0)}, "quaternion: '1,1,0,0' is not a unit quaternion x,y,z,w"),
        ("certify", {"capability": 2.0}, "capability: must be at most 1, is 2.0"),
        ("certify", {"tool_offset_mm": "0,0,nan"}, "tool_offset_mm: '0,0,nan' is not three numbers with ',' or a blank between them"),
        ("certify", {"language": "de"}, "language: 'de' is not one of en, ru"),
        ("import", {"logs": ()}, "logs: must not be empty"),
        ("record", {"passage": 0}, "passage: must be at least 1, is 0"),
        ("motion", {"out": 3}, "out: must be a path, is 3"),
    ],
)
def test_what_makes_no_sense_is_one_line(command: str, wrong: dict[str, Any], line: str) -> None:
    with pytest.raises(SettingsError) as caught:
        requested(command, **wrong)
    assert str(caught.value) == line
    with pytest.raises(SettingsError, match=r"^out: is missing$"):
        load(command).settings(**{key: value for key, value in GIVEN[command].items() if key != "out"})


@pytest.mark.parametrize(
    ("mark", "text", "values"),
    [
        (Separated(":", count=3), "-750:750:50", (-750.0, 750.0, 50.0)),
        (Separated(",", int), "1,2", (1, 2)),
        (Words(",", str), "position,guide", ("position", "guide")),
    ],
)
def test_what_is_written_as_one_text_is_read_as_it_was(mark: Separated, text: str, values: tuple[Any, ...]) -> None:
    assert mark.parsed(text) == values
    assert mark.written(values) == text
    assert mark.parsed(values) is values


def test_a_box_and_words_with_blanks() -> None:
    assert Spans(",").parsed("0:1,-2:3,4:5") == ((0.0, 1.0), (-2.0, 3.0), (4.0, 5.0))
    assert Words(",", str).parsed(" position, ,guide ,") == ("position", "guide")


def test_defaults_are_those_of_the_stages() -> None:
    fit, chosen = CalibrationSettings(), requested("calibrate")
    assert all(getattr(chosen, name) == value for name, value in vars(fit).items() if name != "distances")
    assert fit.distances == chosen.distance == ()
    certified, chosen = vars(CertificationSettings()) | {"trials": 4000, "rule": None}, requested("certify")
    assert chosen.limit_deg == certified.pop("limit_angle_deg")
    del certified["planes"]
    assert all(getattr(chosen, name) == value for name, value in certified.items())
    assert Choices(chosen.language or "en", chosen.key, chosen.dcc, chosen.xsd, chosen.zipped) == Choices()
    assert LANGUAGES == ("en", "ru")
    limits, chosen = vars(Limits()), requested("zone")
    assert chosen.limit_deg == limits.pop("angle_deg")
    assert all(getattr(chosen, name) == value for name, value in limits.items())
    chosen = requested("plan-poses")
    plan = vars(pose_choice.PlanSettings(4, None))  # type: ignore[arg-type]
    assert all(getattr(chosen, name) == plan[name] for name in ("criterion", "solve", "passes", "further", "seed"))
    assert set(CRITERIA) == {"G", "I", "D"}
    # a form knows no infinity, and what a person types into a controller is wanted away from its singular angles
    limits = vars(reach.Limits()) | {"max_length_mm": 1e6, "singular_deg": 2.0}
    assert all(getattr(chosen, name) == value for name, value in limits.items())
    cube, chosen = CubeTests(), requested("program")
    assert (chosen.quaternion, chosen.speed, chosen.path_speed) == (cube.quaternion, cube.speed_mm_s, cube.path_speed_mm_s)
    assert (chosen.speeds, chosen.loads, chosen.dwell) == (cube.speeds_percent, cube.loads_kg, cube.dwell_s)
    assert (3600.0 * chosen.drift_hours, chosen.limit_band) == (cube.drift_s, cube.limit_band_mm)
    assert set(chosen.tests) < set(cube.tests)  # those of an hour
    assert requested("motion").half_width_s is None
    assert requested("place").generations == GENERATIONS


@pytest.mark.parametrize(
    ("command", "typed", "meant"),
    [
        ("import", "log.asc --position-mm 1 -2 3e2 two.asc", "log.asc --position-mm=1,-2,3e2 two.asc"),
        ("import", "--position-mm 1 2 3 --quaternion-xyzw 0 0 0 1 log.asc", "--position-mm=1,2,3 --quaternion-xyzw=0,0,0,1 log.asc"),
        ("import", "--position-mm 0,0,0 --start 1, 2, 3, 0, -90, 90 log.asc", "--position-mm 0,0,0 --start=1,2,3,0,-90,90 log.asc"),
        ("import", "--position-mm=0 0 0 7 log.asc", "--position-mm=0,0,0 7 log.asc"),  # the fourth is another word
        ("import", "--start run.toml 1 2", "--start run.toml 1 2"),
        ("import", "--position-mm --scan 1 2", "--position-mm --scan 1 2"),
        ("import", "-- --position-mm 1 2 3", "-- --position-mm 1 2 3"),
        ("structure", "s.toml --lengths-mm 10 11 12 13 14 15 --out s.json", "s.toml --lengths-mm=10,11,12,13,14,15 --out s.json"),
        ("zone", "--tilt-steps 3 4 --quaternion 0 0 0 1", "--tilt-steps 3 4 --quaternion=0,0,0,1"),
        ("zone", "--quaternion kuka-abc:10 -20 30 40", "--quaternion=kuka-abc:10,-20,30 40"),
        ("mechanism", "--quaternion puma-oat: 20, -90, 90 rotopod", "--quaternion=puma-oat:20,-90,90 rotopod"),
        ("mechanism", "--quaternion 0 0 0 1 of:1 --position-mm of:1 2 3", "--quaternion=0,0,0,1 of:1 --position-mm of:1 2 3"),
        ("program", "--speeds 100 50 --tests pose path", "--speeds=100,50 --tests pose path"),
        ("calibrate", "--solve position guide --start 0 0 0 0 0 0 1 5", "--solve position guide --start=0,0,0,0,0,0,1 5"),
    ],
)  # fmt: skip
def test_numbers_in_a_row_may_have_blanks_between_them(command: str, typed: str, meant: str) -> None:
    assert with_commas(typed.split(), rows_of_numbers(load(command).settings)) == meant.split()


def test_every_row_of_numbers_takes_blanks() -> None:
    """Each option whose place-holder has numbers with commas is among them."""
    rows = {(name, flag) for name in COMMANDS for flag in rows_of_numbers(load(name).settings)}
    assert len(rows) > 20
    for name in COMMANDS:
        for option in options_of(load(name).settings):
            row = option.metavar.upper().split("|")[0].removesuffix("[,QX,QY,QZ,QW]").split(",")
            assert (len(row) > 2 and max(map(len, row)) <= 2) <= ((name, option.flag) in rows), f"{name} {option.flag}"
    assert Separated(",", count=3).parsed("0 -1.5  2") == Separated(",", count=3).parsed(" 0, -1.5 ,2 ") == (0.0, -1.5, 2.0)
    for text in ("0 0", "0,,0", "0;0;0", ""):
        with pytest.raises(ValueError, match="three numbers with ',' or a blank between them"):
            Separated(",", count=3).parsed(text)


def test_help_names_the_formats_that_are_read() -> None:
    logs, dialect = (load(c).settings.model_fields[n].description or "" for c, n in (("import", "logs"), ("correct", "dialect")))
    assert [suffix for suffix in log_suffixes() if suffix not in logs] == []
    assert [name for name in dialect_names() if name not in dialect] == []
