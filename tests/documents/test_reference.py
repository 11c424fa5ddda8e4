"""The reference of the Python names: every public name has its place and its words, and prints and plots as a noun should."""

import re
from pathlib import Path
from runpy import run_path

import lmeasure as lm
from lmeasure.core import Shown
from lmeasure.report.plots import DRAWN

ROOT = Path(__file__).parents[2]
NOT_DRAWN = {"DrumMeasurement", "PoseCovariances", "Campaign", "CalibrationSettings", "CertificationSettings", "LMeasureError"}
"""What is read, asked or raised, and is no picture."""


def test_every_public_name_has_its_place_in_the_reference(tmp_path: Path) -> None:
    page = run_path(str(ROOT / "docs" / "make_api.py"))["write_api"](tmp_path).read_text(encoding="utf-8")
    anchors = set(re.findall(r'<section id="(\w+)"', page))
    assert set(lm.__all__) <= anchors
    assert not re.findall(r'(?:src|href)="https?://(?!pdoc\.dev)', page)
    assert str(ROOT) not in page


def test_every_public_name_says_what_it_is() -> None:
    for name in lm.__all__:
        assert (getattr(lm, name).__doc__ or "").strip(), name


def test_nouns_print_and_plot() -> None:
    nouns = {name: kind for name in lm.__all__ if isinstance(kind := getattr(lm, name), type)}
    assert {name for name, kind in nouns.items() if kind not in DRAWN} == NOT_DRAWN
    for name, kind in nouns.items():
        if kind in DRAWN:
            assert issubclass(kind, Shown), name
            assert kind._repr_html_ is Shown._repr_html_, name
