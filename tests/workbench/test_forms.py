"""Forms say what command lines say: the way from one to the other and back, for every command."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from bench import client
from hypothesis import given, settings, strategies as st

from lmeasure.cli.commands import command
from lmeasure.core import LMeasureError, SettingsError
from lmeasure.workbench import forms
from lmeasure.workbench.cards import PAGES, card
from lmeasure.workbench.project import Project, ProjectFile, look_at
from lmeasure.workflows import COMMANDS, Option, command_line, load, options_of
from lmeasure.workflows.options import limits_of

RUN = [name for name in COMMANDS if name not in forms.NOT_HERE]
WORDS = st.text("abcxyz-_.0123456789", min_size=1, max_size=12)


def values_of(option: Option) -> st.SearchStrategy[Any]:
    """What may stand in a field."""
    if option.kind == "flag":
        return st.sampled_from(["on", "off"])
    if option.kind == "choice":
        return st.sampled_from(option.choices)
    if option.kind == "list":
        return st.lists(WORDS, min_size=1, max_size=3)
    low = -99.0 if option.minimum is None else option.minimum
    if option.kind == "whole":
        return st.integers(int(low), int(low) + 1000).map(str)
    if option.kind == "number":
        return st.floats(low, low + 1000, allow_nan=False).map(repr)
    return WORDS


def parsed(name: str, words: list[str]) -> dict[str, Any]:
    """What the command line makes of words."""
    made = command(name)
    context = made.make_context("lmeasure", list(words), resilient_parsing=True)
    return {key: value for key, value in context.params.items() if value not in (None, [], ())}


@pytest.mark.parametrize("name", RUN)
def test_a_form_and_its_command_line_say_the_same(name: str) -> None:
    """And the command line's own parser understands the same by it."""
    options = [option for option in options_of(load(name).settings) if option.name not in forms.HIDDEN]
    model = load(name).settings

    @settings(max_examples=10)
    @given(st.data())
    def holds(data: Any) -> None:
        chosen = data.draw(st.lists(st.sampled_from(options), unique=True, max_size=4))
        chosen += [o for o in options if o.required and o not in chosen]
        session = {o.name: data.draw(values_of(o)) for o in chosen}
        session = {key: value for key, value in session.items() if value != "off"}
        # a switch that is on by itself is on where the form has it
        session |= {o.name: "on" for o in options if o.kind == "flag" and o.default == "on" and o not in chosen}
        given_values = forms.filled_in(name, {"_form": ["1"]} | {k: v if isinstance(v, list) else [v] for k, v in session.items()})
        words = command_line(name, model, given_values)
        back = forms.of_words(name, words)
        plain = {o.name: o.default for o in options}
        for option in options:
            before, after = session.get(option.name, ""), back.get(option.name, "")
            assert after == before or (after == "" and before == plain[option.name]), (option.name, words)
        understood = parsed(name, words[1:])
        for option in chosen:
            if option.kind in ("whole", "number") and option.name in session and option.name in understood:
                assert float(understood[option.name]) == float(session[option.name])
            elif option.kind in ("text", "path", "choice") and option.name in understood:
                assert str(understood[option.name]) == session.get(option.name, understood[option.name])

    holds()


@pytest.mark.parametrize("name", RUN)
def test_every_command_has_a_form_whose_fields_know_unit_range_and_help(name: str) -> None:
    shown = card(name, Project(Path(), (ProjectFile("rig", "rig.toml"), ProjectFile("run", "run"))))
    fields = [*shown.first, *(field for _, fields in shown.more for field in fields)]
    settings = load(name).settings
    left_out = forms.HIDDEN | forms.INSTEAD.get(name, set()) | set(forms.ALWAYS.get(name, {}))
    assert {f.option.name for f in fields} | left_out >= {o.name for o in options_of(settings)}
    for field in fields:
        assert field.option.help
        assert (field.option.minimum, field.option.maximum) == limits_of(settings.model_fields[field.option.name])
    assert all(f.option in [g.option for g in shown.first] for f in fields if f.option.required)


def test_what_is_wrong_stands_at_its_field(tmp_path: Path) -> None:
    for given_values, option in (
        ({"rig": "rig.toml"}, "out"),
        ({"rig": "rig.toml", "out": "z.nc", "tilt_steps": "0"}, "tilt_steps"),
        ({"rig": "rig.toml", "out": "z.nc", "x": "1:2"}, "x"),
        ({"rig": "rig.toml", "out": "z.nc", "limit_deg": "many"}, "limit_deg"),
        ({"rig": "rig.toml", "out": "z.nc", "scheduler": "tcp://elsewhere:1"}, "scheduler"),
    ):
        with pytest.raises(SettingsError) as refused:
            forms.command_words("zone", given_values, tmp_path)
        assert refused.value.option == option
        shown = card("zone", look_at(tmp_path), given=given_values, error=refused.value)
        fields = [*shown.first, *(f for _, more in shown.more for f in more)]
        assert [f.option.name for f in fields if f.error] == ([option] if option not in forms.HIDDEN else [])
    with pytest.raises(LMeasureError, match="not run from a page"):
        forms.command_words("view", {"recording": "a.rrd"}, tmp_path)


def test_what_is_proposed_is_what_the_person_has(tmp_path: Path) -> None:
    """Of a simulated campaign its poses as measured, not the truth beside them; the run of a certificate where there is one only."""
    for name in ("run/run.toml", "trajectory.parquet", "campaign/counts.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    for folder in ("campaign", "campaign/true"):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "rig.toml").write_text('schema = "lmeasure.rig/1"\n')
        (tmp_path / folder / "reference_poses.csv").write_text("pose,x_mm,y_mm,z_mm\n")

    def proposed(command: str) -> dict[str, forms.FieldOf]:
        return {f.option.name: f for f in forms.fields(command, look_at(tmp_path))}

    assert proposed("capture")["poses"].value == "campaign/reference_poses.csv"
    assert (proposed("plan-poses")["poses"].value, proposed("plan-poses")["poses"].offers) == ("20", ())
    assert proposed("certify")["run"].value == "run"
    assert [offer for name in RUN for f in proposed(name).values() for offer in f.offers if "true" in offer] == []
    (tmp_path / "second").mkdir()
    (tmp_path / "second" / "run.toml").touch()
    assert (proposed("certify")["run"].value, len(proposed("certify")["run"].offers)) == ("", 2)


def test_a_line_is_what_a_person_would_type(tmp_path: Path) -> None:
    words = forms.command_words(
        "zone", {"rig": "my rig.toml", "out": "z.nc", "x": "-1:1:1", "tilt_steps": "3", "one_assembly": True}, tmp_path
    )
    assert shlex.join(["lmeasure", *words]) == "lmeasure zone 'my rig.toml' --out z.nc --x=-1:1:1 --one-assembly"
    assert forms.command_words("check", {"rig": "r.toml", "bus": "virtual:a", "turns": False}, tmp_path)[-1] == "--no-turns"


def test_pages_have_only_commands_that_there_are() -> None:
    for page in PAGES.values():
        assert set(page.commands) <= set(RUN)


def test_names_for_what_is_written_are_free(tmp_path: Path) -> None:
    (tmp_path / "zones").mkdir()
    (tmp_path / "zones" / "zone.nc").write_text("")
    assert forms.suggested("zone", "out", look_at(tmp_path)) == "zones/zone-2.nc"


def test_tables_are_found_as_they_are_read(tmp_path: Path) -> None:
    """Commas, semicolons, tabs, quoted names, the mark of Windows editors: what the commands read is offered to them."""
    heads = {"trajectory": "time_s,x_mm,y_mm,z_mm", "poses": 'pose;"x_mm";y_mm;z_mm', "measurements": "\ufeffname\tjoint_1_deg\tx_mm"}
    for kind, head in heads.items():
        (tmp_path / f"{kind}.csv").write_text(head + "\n", encoding="utf-8")
    assert {(one.kind, one.path) for one in look_at(tmp_path).found} == {(kind, f"{kind}.csv") for kind in heads}


@pytest.mark.parametrize("language", ["en", "ru"])
def test_what_is_not_there_or_lacking_is_said_in_the_readers_language(tmp_path: Path, language: str) -> None:
    (tmp_path / "rig.toml").write_text("")
    form = {"_form": "1", "rig": "rig.toml", "out": "planned.csv", "poses": "12"}
    with client(tmp_path) as session:
        session.headers["Accept-Language"] = language
        reported = session.post("/line/plan-poses", data=form).json()
        assert reported["option"] == "box"
        assert (
            "Укажите, где может двигаться робот"
            if language == "ru"
            else "State the region of the robot: a box, or a calibration to extend."
        ) in reported["error"]
        refused = session.post("/run/plan-poses", data=form)
        assert refused.status_code == 422
        assert reported["error"] in refused.text
        assert session.get("/api/jobs").json()["jobs"] == []
        for path in ("/nowhere", "/jobs/99", "/raw/nowhere.csv", "/run/nothing"):
            answer = session.get(path)
            assert answer.status_code == 404
            assert "Not Found" not in answer.text
            said = answer.text.split('role="alert">')[1].split("<")[0].replace(path, "").replace("nothing:", "")
            assert bool(re.search("[A-Za-z]", said)) == (language == "en"), said
