"""A certificate as tables for other programs: a workbook whose formulas recompute u and U95, a .csv and a .mat file.

Numbers have all digits, texts are the English ones of certificate.json. A text is never a formula: the workbook has it as a string, and the
.csv file has ' before one that a spreadsheet would compute.
"""

import csv
import datetime
import io
import math
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from lmeasure.certificate import Measured, chosen
from lmeasure.io import harmless
from lmeasure.iso9283 import key_of
from lmeasure.report.readable import line_alike, xml_text

ABOUT = ("name", "pose", "path", "part")
RESULT = (*ABOUT, "value", "unit", "u95", "coverage_factor", "u", "degrees_of_freedom", "u_drawn", "bias", "cycles", "capable")
ROW = ("source", "value", "u", "unit", "distribution", "sensitivity", "degrees_of_freedom", "contribution", "share_percent")
ATTAINED = ("pose", "cycle", "time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw", "deviation_mm")
LARGEST = 200_000_000
"""Bytes of a workbook's part, unpacked."""


def workbook(certificate: dict[str, Any], measured: Measured) -> bytes:
    """certificate.xlsx: results, budget, correlations, attained poses, charts; the same certificate gives the same bytes."""
    import xlsxwriter

    out = io.BytesIO()
    options = {"in_memory": True, "strings_to_formulas": False, "strings_to_urls": False, "nan_inf_to_errors": True}
    with xlsxwriter.Workbook(out, options) as book:
        book.set_properties({"title": certificate["id"], "created": datetime.datetime.fromisoformat(certificate["created"])})
        bold = book.add_format({"bold": True})
        results, budget = book.add_worksheet("results"), book.add_worksheet("budget")
        first_rows = _budget(budget, certificate, bold)
        _results(results, certificate, first_rows, bold)
        _table(book.add_worksheet("correlations"), _correlations(certificate), bold)
        poses = list(attained(measured))
        _table(book.add_worksheet("attained poses"), [ATTAINED, *poses], bold)
        _charts(book, certificate, first_rows, len(poses))
    return out.getvalue()


def _write(sheet: Any, row: int, column: int, value: object) -> None:
    if isinstance(value, bool | str):
        sheet.write_string(row, column, str(value).lower() if isinstance(value, bool) else value)
    elif value is not None and math.isfinite(value):  # type: ignore[arg-type]
        sheet.write_number(row, column, value)


def _table(sheet: Any, rows: Sequence[Sequence[object]], bold: Any) -> None:
    for i, row in enumerate(rows):
        for j, value in enumerate(row):
            _write(sheet, i, j, value)
    sheet.set_row(0, None, bold)
    sheet.freeze_panes(1, 0)
    sheet.autofit()


def _budget(sheet: Any, certificate: dict[str, Any], bold: Any) -> dict[int, tuple[int, int]]:
    """Write the rows of all budgets; the first and last row of each figure."""
    rows: list[list[object]] = [["result", *ROW]]
    spans = {}
    for i, figure in enumerate(certificate["characteristics"]):
        if figure.get("budget"):
            spans[i] = (len(rows), len(rows) + len(figure["budget"]) - 1)
            rows += [[str(key_of(figure)), *(row[key] for key in ROW)] for row in figure["budget"]]
    from xlsxwriter.utility import xl_rowcol_to_cell as cell

    _table(sheet, rows, bold)
    u, sensitivity, contribution, share = (1 + ROW.index(key) for key in ("u", "sensitivity", "contribution", "share_percent"))
    for first, last in spans.values():
        whole = f"SUMSQ({cell(first, contribution, True, True)}:{cell(last, contribution, True, True)})"
        for row in range(first, last + 1):
            sheet.write_formula(row, contribution, f"=ABS({cell(row, u)}*{cell(row, sensitivity)})", None, rows[row][contribution])
            sheet.write_formula(row, share, f"=IF({whole}=0,0,100*{cell(row, contribution)}^2/{whole})", None, rows[row][share])
    return spans


def _results(sheet: Any, certificate: dict[str, Any], spans: dict[int, tuple[int, int]], bold: Any) -> None:
    from xlsxwriter.utility import xl_rowcol_to_cell as cell

    figures = certificate["characteristics"]
    _table(sheet, [RESULT, *([figure.get(key) for key in RESULT] for figure in figures)], bold)
    u, k, u95, contribution = (*(RESULT.index(key) for key in ("u", "coverage_factor", "u95")), 1 + ROW.index("contribution"))
    for i, (first, last) in spans.items():
        row = i + 1
        sheet.write_formula(row, u, f"=SQRT(SUMSQ(budget!{cell(first, contribution)}:{cell(last, contribution)}))", None, figures[i]["u"])
        if figures[i].get("coverage_factor") is not None:
            sheet.write_formula(row, u95, f"={cell(row, k)}*{cell(row, u)}", None, figures[i]["u95"])


def _charts(book: Any, certificate: dict[str, Any], spans: dict[int, tuple[int, int]], poses: int) -> None:
    """Draw the shares of the first main result's sources, and the deviations of the poses."""
    sheet = book.add_worksheet("charts")
    main = [certificate["characteristics"].index(one.figure) for one in chosen(certificate)]
    drawn = next((i for i in main if i in spans), None)
    if drawn is not None:
        first, last = spans[drawn]
        share = 1 + ROW.index("share_percent")
        bars = book.add_chart({"type": "bar"})
        bars.add_series({"categories": ["budget", first, 1, last, 1], "values": ["budget", first, share, last, share]})
        bars.set_title({"name": f"{key_of(certificate['characteristics'][drawn])}: share of the variance, %"})
        bars.set_legend({"none": True})
        sheet.insert_chart("A1", bars, {"x_scale": 1.6, "y_scale": 1.4})
    if poses:
        lines = book.add_chart({"type": "scatter"})
        time, deviation = ATTAINED.index("time_s"), ATTAINED.index("deviation_mm")
        lines.add_series(
            {"categories": ["attained poses", 1, time, poses, time], "values": ["attained poses", 1, deviation, poses, deviation]}
        )
        lines.set_title({"name": "distance from the commanded position"})
        lines.set_x_axis({"name": "time, s"})
        lines.set_y_axis({"name": "mm"})
        lines.set_legend({"none": True})
        sheet.insert_chart("A24", lines, {"x_scale": 1.6, "y_scale": 1.2})


def attained(measured: Measured) -> Iterator[tuple[str | float, ...]]:
    """Yield the mean of each dwell, as the columns of `ATTAINED`."""
    for pose in measured.evaluation.poses:
        for cycle, (time, at) in enumerate(zip(pose.time_s.tolist(), pose.poses.tolist(), strict=True), 1):
            yield pose.name, float(cycle), time, *at, math.dist(at[:3], pose.commanded[:3])


def _correlations(certificate: dict[str, Any]) -> list[list[object]]:
    found = certificate["correlations"]
    rows = zip(found["results"], found["coefficients"], strict=True) if found["coefficients"] else ()
    return [["", *found["results"]], *([name, *row] for name, row in rows)]


def _contributions(certificate: dict[str, Any]) -> tuple[list[str], list[list[float]]]:
    """Return the sources of all results, and their contributions to each result."""
    figures = certificate["characteristics"]
    sources = list(dict.fromkeys(row["source"] for f in figures for row in f.get("budget", ())))
    return sources, [
        [math.hypot(*(row["contribution"] for row in f.get("budget", ()) if row["source"] == s)) for s in sources] for f in figures
    ]


def csv_table(certificate: dict[str, Any]) -> bytes:
    """Return certificate.csv: a row for each result, with the contribution of each source."""
    sources, contributions = _contributions(certificate)
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow([*RESULT, *(harmless(f"contribution of {s}") for s in sources)])
    for figure, more in zip(certificate["characteristics"], contributions, strict=True):
        values = (figure.get(key) for key in RESULT)
        rows.writerow(["" if v is None else harmless(v) if isinstance(v, str) else repr(v) for v in (*values, *more)])
    return out.getvalue().encode("utf-8", "backslashreplace")


def mat_file(certificate: dict[str, Any], measured: Measured) -> bytes:
    """certificate.mat (version 5): results, contributions, correlations and attained poses as arrays; NaN where there is no number."""
    figures, found = certificate["characteristics"], certificate["correlations"]
    sources, contributions = _contributions(certificate)
    poses = list(attained(measured))

    def texts(values: Sequence[object]) -> Any:
        return np.array([("" if v is None else str(v)) for v in values], dtype=object)

    def number(value: object) -> float:
        return float(value) if isinstance(value, int | float) else math.nan

    results = {key: texts([f.get(key) for f in figures]) for key in (*ABOUT, "unit")}
    results |= {key: np.array([number(f.get(key)) for f in figures]) for key in RESULT if key not in results}
    content = {
        "id": certificate["id"],
        "results": results,
        "sources": texts(sources),
        "contributions": np.array(contributions).reshape(len(figures), len(sources)),
        "correlation": {"results": texts(found["results"]), "r": np.array(found["coefficients"])},
        "attained": {key: (texts if key == "pose" else np.array)([p[i] for p in poses]) for i, key in enumerate(ATTAINED)},
    }
    import scipy.io

    out = io.BytesIO()
    scipy.io.savemat(out, content)
    # the first 116 bytes are a text with today's date
    return b"MATLAB 5.0 MAT-file, certificate of lmeasure".ljust(116) + out.getvalue()[116:]


def _parts(content: bytes) -> dict[str, str]:
    """Return the parts of a workbook by name; ValueError when it cannot be read."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as book:
            if sum(one.file_size for one in book.infolist()) > LARGEST:
                raise ValueError("is no workbook of a certificate: it is too large")
            return {one.filename: book.read(one).decode("utf-8") for one in book.infolist()}
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, zlib.error) as error:
        raise ValueError(f"is no workbook: {error}") from None


def workbook_text(content: bytes) -> str:
    """All elements and texts of a workbook; ValueError when it cannot be read."""
    return "\n".join(f"{name} {xml_text(part.encode())}" for name, part in sorted(_parts(content).items()))


def workbook_alike(one: bytes, other: bytes) -> bool:
    """Return whether two workbooks are the same but for the last digits of numbers."""
    try:
        a, b = _parts(one), _parts(other)
    except ValueError:
        return False
    return list(a) == list(b) and all(line_alike(a[name], b[name]) for name in a)


def csv_text(content: bytes) -> str:
    """The text of a .csv file; ValueError when it is no UTF-8."""
    return content.decode("utf-8")


def csv_alike(one: bytes, other: bytes) -> bool:
    """Return whether two .csv files are the same but for the last digits of numbers."""
    return line_alike(one.decode("utf-8", "replace"), other.decode("utf-8", "replace"))


def mat_text(content: bytes) -> str:
    """All variables of a .mat file, numbers with six digits; ValueError when it cannot be read."""
    import scipy.io

    try:
        found = scipy.io.loadmat(io.BytesIO(content), simplify_cells=True)
    except Exception as error:
        raise ValueError(f"is no .mat file: {error}") from None
    return "\n".join(_listed(name, value) for name, value in found.items() if not name.startswith("__"))


def _listed(name: str, value: Any) -> str:
    if isinstance(value, dict):
        return "\n".join(_listed(f"{name}.{key}", one) for key, one in value.items())
    return f"{name} " + " ".join(f"{v:.6g}" if isinstance(v, float) else str(v) for v in np.ravel(value).tolist())


def mat_alike(one: bytes, other: bytes) -> bool:
    """Return whether two .mat files have the same variables, numbers to six digits."""
    try:
        return mat_text(one) == mat_text(other)
    except ValueError:
        return False
