"""Conventions that all commands share, from their definitions."""

import re
from pathlib import Path
from typing import Any

import pytest

from lmeasure.cli.commands import command
from lmeasure.core import SettingsError
from lmeasure.workflows import COMMANDS, Writing, fields_of, flag_of, load, said_of

RANGES = {"START:STOP:STEP", "START:STOP[:STEP]", "MIN:MAX", "X0:X1,Y0:Y1,Z0:Z1", "INTERFACE:CHANNEL", "tcp://HOST:PORT"}
"""Forms of values with a colon."""


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_follows_the_conventions(name: str) -> None:
    settings = load(name).settings
    flags = {option: set(parameter.opts) for parameter in command(name).params for option in parameter.opts}
    assert {"--json", "--quiet", "-q", "--verbose", "-v"} <= set(flags)
    pairs = {"--quiet": "-q", "--verbose": "-v", "--out": "-o", "--force": "-f"}
    assert all(short in flags[long] for long, short in pairs.items() if long in flags)
    fields = fields_of(settings)
    for option, field in fields.items():
        said = said_of(field)
        metavar = str(said.get("metavar", ""))
        assert ":" not in metavar or metavar in RANGES, option
        # degrees where people type, radians beside them at most
        assert not option.endswith("_rad") or option.replace("_rad", "_deg") in fields
        if option == "rig" and field.is_required() and name != "drum":  # the subject of `drum` is the table of measurements
            assert "positional" in said, "the rig is an argument where the command is about it"
    if "out" in fields and issubclass(settings, Writing) and "positional" not in said_of(fields["out"]):
        form = said_of(fields["out"]).get("metavar")
        assert bool(settings.OUT_FILE) == ("." in str(form or "") or form == "FILE" or name in NAMED), "--out names a file or a folder"


NAMED = {"reconstruct", "zone", "motion", "drum", "plan-poses"}
"""Commands that write one file; they tell its formats in the help, not in the name of its value."""


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_names_the_one_to_type_next(name: str) -> None:
    settings = load(name).settings
    assert settings.NEXT or "following" in vars(settings)
    words = settings.NEXT.split()
    if words:
        assert words[0] in COMMANDS
        known = {option for parameter in command(words[0]).params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= known
        assert set(re.findall(r"{(\w+)}", settings.NEXT)) <= set(fields_of(settings))


def test_out_of_one_file_may_be_a_folder(tmp_path: Path) -> None:
    settings: Any = load("zone").settings
    for out in (str(tmp_path), f"{tmp_path}/new/"):
        assert settings.model_validate({"rig": "rig.toml", "out": out}).out == Path(out) / "zone.nc"
    assert settings.model_validate({"rig": "rig.toml", "out": f"{tmp_path}/new"}).out == tmp_path / "new"


def test_the_cube_of_a_program_takes_the_ranges_of_a_zone() -> None:
    settings: Any = load("program").settings
    assert settings.model_validate({"out": "p", "x": "-10:20:5"}).x == (-10.0, 20.0)
    with pytest.raises(SettingsError, match="is not two numbers"):
        settings.model_validate({"out": "p", "x": "-10:20:x"})


def test_former_options_are_arguments() -> None:
    for name in ("check", "watch", "record"):
        one = command(name)
        rest = ["--bus", "replay:none", *(["--out", "run"] if name == "record" else [])]
        by_option, by_place = (one.make_context(name, [*rig, *rest]).params for rig in (["--rig", "r.toml"], ["r.toml"]))
        assert by_option == by_place
    assert next(flag_of(key, field) for key, field in fields_of(load("check").settings).items()) == "RIG"
