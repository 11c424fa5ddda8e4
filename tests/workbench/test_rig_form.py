"""The rig as a form: what is typed is written with the file's comments, and nothing that is no rig is written."""

import contextlib
import json
import threading
import urllib.request
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from bench import client, served, token
from browser import opened
from clicks import entered, press, visit

from lmeasure.kernels import compilation
from lmeasure.rig import read_rig, write_rig
from lmeasure.simulation import cell_rig
from lmeasure.templates import TEMPLATES, Answers, rig_of, rig_text
from lmeasure.workbench import rig_form
from lmeasure.workflows import load


@cache
def begun() -> str:
    """A rig as `lmeasure init` begins it."""
    template = TEMPLATES["six-cables"]
    return rig_text(rig_of(template, Answers()), template.text)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "rig.toml"
    file.write_text(begun())
    return file


def typed(path: Path, **changed: str) -> dict[str, str]:
    document, digest = rig_form.read(path)
    leaves = {leaf.key: leaf.value for _, leaves in rig_form.parts(document) for leaf in leaves}
    return leaves | {"_digest": digest} | {key.replace("__", "."): value for key, value in changed.items()}


def test_a_form_that_was_not_touched_changes_no_byte(path: Path) -> None:
    before = path.read_bytes()
    assert rig_form.save(path, typed(path)) == []
    assert path.read_bytes() == before


def test_one_value_changes_one_line(path: Path) -> None:
    before = path.read_text().splitlines()
    assert rig_form.save(path, typed(path, observation_point__0__position_mm__1="-1642.2")) == []
    after = path.read_text().splitlines()
    assert len([1 for a, b in zip(before, after, strict=True) if a != b]) == 1
    assert read_rig(path).observation_point[0].position_mm[1] == -1642.2


def test_every_value_of_the_file_has_a_field_and_every_field_its_value(path: Path) -> None:
    document, _ = rig_form.read(path)
    leaves = {leaf.key: leaf for _, leaves in rig_form.parts(document) for leaf in leaves}
    assert len([key for key in leaves if "position_mm" in key]) == 18
    assert {leaf.unit for key, leaf in leaves.items() if key.endswith("_deg")} == {"deg"}
    assert leaves["observation_point.2.pulley_radius_mm"].assumed
    assert not leaves["observation_point.2.position_mm.0"].assumed
    # each by itself, changed and read again
    for key, leaf in leaves.items():
        if leaf.kind == "number":
            content, wrong = rig_form.filled(document, {key: "7"})
            assert wrong == []
            here: Any = content
            for step in key.split("."):
                here = here[int(step)] if isinstance(here, list) else here[step]
            assert here == 7


def test_all_complaints_come_at_once_and_nothing_is_written(path: Path) -> None:
    before = path.read_bytes()
    wrong = {"observation_point__0__pulley_radius_mm": "-3", "observation_point__1__drum__count_sign": "5", "cable__3__from": "B9"}
    complaints = rig_form.save(path, typed(path, **wrong))
    assert len(complaints) >= 3
    assert any("pulley_radius_mm" in c for c in complaints)
    assert any("B9" in c for c in complaints)
    assert rig_form.save(path, typed(path, observation_point__0__position_mm__0="far")) == [
        "observation_point.0.position_mm.0: 'far' is not a number"
    ]
    assert path.read_bytes() == before


def test_a_file_that_somebody_changed_meanwhile_is_not_written_over(path: Path) -> None:
    form = typed(path, observation_point__0__position_mm__0="1.0")
    path.write_text(path.read_text() + "\n# by hand\n")
    assert "has been changed by another program" in rig_form.save(path, form)[0]
    assert "# by hand" in path.read_text()


def test_the_page_saves_and_shows_again_what_was_typed(path: Path) -> None:
    with client(path.parent) as session:
        page = session.get("/rig?file=rig.toml").text
        assert 'data-arrow="R"' in page
        assert "<style" not in page
        form = typed(path, observation_point__0__position_mm__0="12.5") | {"_file": "rig.toml"}
        assert session.post("/rig", data=form).status_code == 303
        assert read_rig(path).observation_point[0].position_mm[0] == 12.5
        wrong = typed(path, observation_point__0__pulley_radius_mm="-3") | {"_file": "rig.toml"}
        answer = session.post("/rig", data=wrong, headers={"accept-language": "ru"})
        assert answer.status_code == 422
        beside = answer.text.partition('name="observation_point.0.pulley_radius_mm"')[2].partition("</div>")[0]
        assert "должно быть не меньше 0" in beside
        assert 'value="-3"' in answer.text


def test_a_coarse_zone_is_the_zone_on_its_grid(tmp_path: Path) -> None:
    """Against the map itself on the same nodes; and a rig whose points fall together has none."""
    from lmeasure.accuracy import Limits, Scan, axis, box_around, map_zone, tilts

    rig = cell_rig(0)
    write_rig(tmp_path / "rig.toml", rig)
    places = {p.name: tuple(p.position_mm) for p in rig.observation_point}
    reported = rig_form.coarse(tmp_path / "rig.toml", places)
    spans = [(a, b, (b - a) / rig_form.COARSE) for a, b, _ in box_around(rig)]
    nodes = axis(*spans[0]), axis(*spans[1]), axis(*spans[2])
    spacing = (spans[0][2], spans[1][2], spans[2][2])
    data = map_zone(rig, None, nodes, tilts(0.0, 1, None), scan=Scan(limits=Limits(60.0), spacing_mm=spacing))
    assert reported["zone_volume_mm3"] == pytest.approx(float(data["in_zone"].values.sum()) * spacing[0] * spacing[1] * spacing[2])
    assert reported["zone_volume_mm3"] > 0.0
    first = next(iter(places.values()))
    assert (
        rig_form.coarse(tmp_path / "rig.toml", {name: (first[0] + i, first[1], first[2]) for i, name in enumerate(places)})[
            "zone_volume_mm3"
        ]
        < 0.2 * reported["zone_volume_mm3"]
    )


def test_a_rig_that_has_no_zone_is_told_so_and_a_wrong_request_is_one(tmp_path: Path) -> None:
    """Two cables tell no pose: an answer with a reason, which is no fault of who asks."""
    rig = cell_rig(0)
    write_rig(tmp_path / "rig.toml", rig.model_copy(update={"cable": rig.cable[:2]}))
    places = {p.name: list(p.position_mm) for p in rig.observation_point}
    with client(tmp_path) as session:
        reported = session.post("/coarse", json={"file": "rig.toml", "points": places})
        assert reported.status_code == 200
        assert "has 2 cables" in reported.json()["error"]
        for wrong in ({"file": "rig.toml"}, {"file": "../rig.toml", "points": places}, {"file": "rig.toml", "points": {"B1": ["a", 0, 0]}}):
            assert session.post("/coarse", json=wrong).status_code == 422


def test_while_kernels_are_compiled_the_coarse_zone_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which one, how long all of it takes, and how long this has taken; in both languages."""
    write_rig(tmp_path / "rig.toml", cell_rig(0))
    done, coarse = threading.Event(), rig_form.coarse

    def cold(*session: Any) -> dict[str, float]:
        compilation.start("worst_angle")
        assert done.wait(300.0)
        compilation.end("worst_angle")
        return coarse(*session)

    monkeypatch.setattr(compilation, "names", [])
    monkeypatch.setattr(rig_form, "coarse", cold)
    shown = "document.getElementById('scene-zone').textContent"
    with served(tmp_path) as address, opened(address) as page:
        for language, reported in (("ru", r"worst_angle \.\.\.. прошло \d+ с"), ("en", r"worst_angle \.\.\.. \d+ s so far")):
            press(page, f".language [value={language}]", f"document.documentElement.lang === '{language}'")
            visit(page, entered(page), "/rig")
            page.wait(f"new RegExp({json.dumps(reported)}).test({shown})")
        done.set()
        page.wait(f"{shown}.includes('m³')")
    assert compilation.now() is None


def test_a_server_that_ends_while_a_zone_is_computed_prints_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_rig(tmp_path / "rig.toml", cell_rig(0))
    begun, done = threading.Event(), threading.Event()

    def slow(*_: object) -> dict[str, float]:
        begun.set()
        assert done.wait(60.0)
        return {}

    monkeypatch.setattr(rig_form, "coarse", slow)
    monkeypatch.setattr("lmeasure.workbench.server.GRACE_S", 0)
    with served(tmp_path) as address:
        origin = address.partition("/?")[0]
        headers = {"Authorization": f"Bearer {token(tmp_path)}", "Origin": origin}
        session = urllib.request.Request(f"{origin}/coarse", b'{"file": "rig.toml", "points": {}}', headers)

        def ask() -> None:
            with contextlib.suppress(OSError):
                urllib.request.urlopen(session)

        waiting = threading.Thread(target=ask)
        waiting.start()
        assert begun.wait(60.0)
        threading.Timer(0.5, done.set).start()
    waiting.join()
    assert capsys.readouterr().err == ""


def test_drums_and_the_task_of_a_placement_have_forms_too(tmp_path: Path) -> None:
    """With the command that takes them below; what would be none of them is not written."""
    init = load("init")
    init.run(init.settings.model_validate({"out": tmp_path, "template": "six-cables"}))
    with client(tmp_path) as session:
        for name, key, text, wrong, command in (
            ("drums.toml", "drum.1.centre_distance_mm", "181.5", "-3", "drum"),
            ("placement.toml", "mount.0.low_mm.2", "1700.5", "1e9", "place"),
        ):
            page = session.get(f"/rig?file={name}").text
            assert f'name="{key}"' in page
            assert f'data-command="{command}"' in page
            assert 'id="scene"' not in page
            lines = (tmp_path / name).read_text().splitlines()
            form = typed(tmp_path / name) | {"_file": name}
            refused = session.post("/rig", data=form | {key: wrong})
            assert refused.status_code == 422, name
            assert (tmp_path / name).read_text().splitlines() == lines
            assert session.post("/rig", data=form | {key: text}).status_code == 303
            after = (tmp_path / name).read_text().splitlines()
            (changed,) = (b for a, b in zip(lines, after, strict=True) if a != b)
            assert text in changed
