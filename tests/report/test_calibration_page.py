"""The page of a calibration: its marks have figures, its label stands apart, and what rounding leaves is no result."""

import math
import re
from dataclasses import replace
from pathlib import Path

import pages
import pytest

from lmeasure.calibration import compare
from lmeasure.calibration.validation.compare import Earlier
from lmeasure.report import write_calibration_page
from lmeasure.report.calibration_figures import narrowed_figure, spectrum_figure
from lmeasure.report.readable import page_text
from lmeasure.rig import CalibrationRecord


@pytest.fixture(scope="module")
def record() -> CalibrationRecord:
    return pages.undetermined().record


def written(tmp_path: Path, changed: CalibrationRecord) -> tuple[str, str]:
    """Source and words of the page of a changed record."""
    write_calibration_page(tmp_path / "report.html", replace(pages.undetermined(), record=changed))
    content = (tmp_path / "report.html").read_bytes()
    return content.decode(), page_text(content)


def test_a_calibration_without_an_equation_left_over_shows_no_rounding(record: CalibrationRecord, tmp_path: Path) -> None:
    exact = tuple(r.model_copy(update={"mm": 3e-13 * (-1) ** k}) for k, r in enumerate(record.residuals))
    noise = record.noise | {"degrees_of_freedom": 0.0, "residual_rms_mm": 3e-13, "chi_squared": 7e-20}
    source, words = written(tmp_path, record.model_copy(update={"residuals": exact, "noise": noise, "inputs": ()}))
    assert 'id="residuals"' not in source
    assert "All are zero" in words
    assert re.search(r"Residuals of the fit [^.]* 0 mm rms", words)
    assert "none: no redundant equations" in words
    # coarse solutions of as many poses as unknowns fit to rounding too
    assert "10⁻" not in words
    assert "Inputs" not in words
    source, words = written(tmp_path, record)
    assert 'id="residuals"' in source
    assert "All are zero" not in words
    assert "Inputs file SHA-256 rig.toml" in words


def test_limitations_are_counted_as_they_are_listed(record: CalibrationRecord, tmp_path: Path) -> None:
    warnings = tuple(w for w in record.warnings if w.code == "underdetermined")
    assert warnings
    words = written(tmp_path, record.model_copy(update={"warnings": warnings}))[1]
    assert f"Limitations: {len(warnings)} (below)" in words


@pytest.mark.parametrize("ends", [(4.9, 31.0), (0.03, 31.0), (1e-4, 1e3), (5.0, 5.0)])
def test_an_axis_of_uncertainties_has_figures(record: CalibrationRecord, ends: tuple[float, float]) -> None:
    own = tuple(p.model_copy(update={"u": ends[0], "prior_u": ends[1]}) for p in record.parameters)
    axis = narrowed_figure(record.model_copy(update={"parameters": own})).layout.xaxis
    assert 2 <= len(axis.tickvals) <= 10
    assert all(f"{value:e}"[0] in "125" for value in axis.tickvals)
    assert [float(text) for text in axis.ticktext] == pytest.approx(axis.tickvals)
    # beside what is drawn, whose margin is a part of it
    assert any(ends[0] / 1.1 <= value <= 1.1 * ends[1] for value in axis.tickvals)


def test_what_the_line_means_stands_above_it(record: CalibrationRecord) -> None:
    """Where directions are known, at the left, all marks lie below."""
    figure = spectrum_figure(record)
    label, axis = figure.layout.annotations[0], figure.layout.yaxis
    assert (label.yanchor, label.y) == ("bottom", 0.0)
    assert axis.autorangeoptions.include >= 4.0
    left = [d["left"] for d in record.spectrum]
    assert axis.dtick * 7 >= math.log10(max(left) / min(left))


def test_a_column_that_marks_nothing_is_not_there(tmp_path: Path) -> None:
    earlier = Earlier(pages.calibrated().rig, pages.calibrated().record, "earlier")
    found = compare(earlier, pages.again())
    moved = replace(found, points=tuple(replace(p, moved=True) for p in found.points))
    for comparison, columns in ((found, [5, 5]), (moved, [6, 5])):
        write_calibration_page(tmp_path / "report.html", pages.again(), comparison)
        source = (tmp_path / "report.html").read_text(encoding="utf-8")
        tables = source[source.index("Since the calibration") : source.index("Predicted standard")].split("<table>")[1:3]
        assert [table.split("</tr>")[0].count("<th>") for table in tables] == columns
        assert [table.split("</tr>")[1].count("<td>") for table in tables] == columns
