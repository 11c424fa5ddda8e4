"""The tour: from stop to stop by its buttons, on the demo's files or without them; what it points at is there."""

import re
import shutil
from html import unescape
from pathlib import Path

from bench import client

from lmeasure.rig import write_rig
from lmeasure.simulation import cell_rig
from lmeasure.workbench import forms, tour
from lmeasure.workbench.project import look_at

SEALED = Path(__file__).parents[1] / "authorities" / "sealed" / "with-run"


def some_files_of_the_demo(folder: Path) -> None:
    """The simulated cell, as far as the tour looks at it."""
    shutil.copytree(SEALED, folder / "cell" / "certificate")
    shutil.copytree(SEALED / "inputs" / "run", folder / "cell" / "run")
    shutil.copy(SEALED / "inputs" / "trajectory.parquet", folder / "cell" / "trajectory.parquet")
    (folder / "cell" / "campaign").mkdir()
    (folder / "cell" / "calibration").mkdir()
    (folder / "cell" / "calibration" / "report.html").write_text("<!doctype html><title>calibration</title>")
    (folder / "cell" / "certificate" / "report.html").write_text("<!doctype html><title>certificate</title>")
    write_rig(folder / "cell" / "campaign" / "rig.toml", cell_rig(0))


def there(page: str, points_at: str) -> bool:
    """Whether a page has what is pointed at: an id, a class, or an element of a class."""
    tag, mark, name = re.fullmatch(r"(\w*)([.#])([\w-]+)", points_at).groups()  # type: ignore[union-attr]
    return re.search(rf"<{tag or '[a-z]+'}\b[^>]*\b{'id' if mark == '#' else 'class'}=\"[^\"]*\b{name}\b", page) is not None


def test_every_stop_is_reached_by_its_button_and_points_at_something(tmp_path: Path) -> None:
    some_files_of_the_demo(tmp_path)
    with client(tmp_path) as asked:
        address = "/?tour=1"
        visited: list[str] = []
        while address:
            answer = asked.get(address)
            assert answer.status_code == 200, address
            stop = tour.STOPS[len(visited)]
            assert there(answer.text, stop.points_at), (address, stop.points_at)
            visited.append(address)
            found = re.search(r'data-next href="([^"]+)"', answer.text)
            address = unescape(found[1]) if found else ""
    assert len(visited) == len(tour.STOPS)
    assert "/trajectory/cell/trajectory.parquet?tour=8" in visited


def test_without_the_demo_the_tour_stays_on_pages_that_are_there(tmp_path: Path) -> None:
    with client(tmp_path) as asked:
        for number in range(len(tour.STOPS)):
            assert asked.get(tour.address(look_at(tmp_path), number)).status_code == 200
        assert "tour-bar" not in asked.get("/?tour=99").text
        assert "tour-bar" not in asked.get("/?tour=x").text


def test_home_tries_a_robot_that_is_certified_once(tmp_path: Path) -> None:
    """What the pages look at; correcting it and certifying it again would take as long once more."""
    with client(tmp_path) as asked:
        form = re.search(r'<form method="post" action="/run/demo">(.*?)</form>', asked.get("/").text)
    assert form is not None
    typed = {name: [value] for name, value in re.findall(r'name="(\w+)" value="(\w+)"', form[1])}
    assert forms.asked("demo", forms.filled_in("demo", typed), tmp_path) == ["demo", "--out", "cell", "--robot", "--no-correct"]
