"""Certificates as workbook, .csv and .mat: formulas recompute u and U95, and no text of a user is a formula."""

import csv
import io
import json
import math
import re
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
import scipy.io
from in_process import ran

from lmeasure.certificate import verify
from lmeasure.io import harmless
from lmeasure.report import PRINTERS

SEALED = Path(__file__).parents[1] / "authorities" / "sealed" / "with-run" / "inputs"
HOSTILE = '=HYPERLINK("http:x")'
CELL = re.compile(r"\$?([A-Z]+)\$?(\d+)")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A certificate of a program one of whose poses is named as a formula."""
    here = tmp_path_factory.mktemp("tables")
    shutil.copytree(SEALED, here / "inputs")
    program = here / "inputs" / "program.toml"
    named = program.read_text()
    program.write_text(named.replace('name = "P1"', f"name = '{HOSTILE}'"))
    command = f"certify inputs/trajectory.parquet --program inputs/program.toml --run inputs/run --trials 100 --tables --out {here}/c"
    command = command.replace("inputs/", f"{here}/inputs/")
    ran(*command.split())
    return here / "c"


@pytest.fixture(scope="module")
def figures(folder: Path) -> list[dict[str, Any]]:
    return list(json.loads((folder / "certificate.json").read_text())["characteristics"])


def evaluated(book: Any, sheet: str, formula: str) -> float:
    """The value of a formula of the five functions that the workbook uses, by cells of numbers and formulas."""

    def value(of: str, name: str) -> float:
        found = book[of][name.replace("$", "")].value
        return evaluated(book, of, found[1:]) if isinstance(found, str) and found.startswith("=") else float(found)

    def squares(match: re.Match[str]) -> str:
        of, first, last = match[1] or sheet, CELL.fullmatch(match[2]), CELL.fullmatch(match[3])
        assert first is not None
        assert last is not None
        return repr(sum(value(of, f"{first[1]}{row}") ** 2 for row in range(int(first[2]), int(last[2]) + 1)))

    text = re.sub(r"SUMSQ\((?:(\w+)!)?([$\w]+):([$\w]+)\)", squares, formula)
    text = re.sub(r"IF\(([^=]+)=0,0,(.+)\)", r"(0 if \1==0 else \2)", text)
    text = CELL.sub(lambda m: repr(value(sheet, m[0])), text).replace("^", "**").replace("SQRT", "math.sqrt").replace("ABS", "abs")
    return float(eval(text, {"math": math, "abs": abs, "__builtins__": {}}))


def test_formulas_recompute_u_and_u95_from_the_budget(folder: Path, figures: list[dict[str, Any]]) -> None:
    formulas, shown = (openpyxl.load_workbook(folder / "certificate.xlsx", data_only=only) for only in (False, True))
    assert formulas.sheetnames == ["results", "budget", "correlations", "attained poses", "charts"]
    header = [c.value for c in formulas["results"][1]]
    u, u95 = header.index("u"), header.index("u95")
    for row, figure in list(enumerate(figures, 2))[::7]:
        cells, values = formulas["results"][row], shown["results"][row]
        for column, key in ((u, "u"), (u95, "u95")):
            assert cells[column].data_type == "f"
            assert evaluated(formulas, "results", cells[column].value[1:]) == pytest.approx(figure[key], rel=1e-9)
            assert values[column].value == pytest.approx(figure[key], rel=1e-12)
    budget = formulas["budget"]
    shares: dict[str, float] = {}
    for row in range(2, 60):
        shares[budget.cell(row, 1).value] = shares.get(budget.cell(row, 1).value, 0.0) + evaluated(
            formulas, "budget", budget.cell(row, 10).value[1:]
        )
    assert all(share == pytest.approx(100.0, rel=1e-9) for share in list(shares.values())[:-1])
    assert len(formulas["charts"]._charts) == 2
    assert formulas["attained poses"].max_row == 1 + 3 * 2


def test_no_text_of_a_user_is_a_formula(folder: Path, figures: list[dict[str, Any]]) -> None:
    book = openpyxl.load_workbook(folder / "certificate.xlsx")
    named = [c for row in book["results"].iter_rows() for c in row if c.value == HOSTILE]
    assert named
    with zipfile.ZipFile(folder / "certificate.xlsx") as parts:
        assert "HYPERLINK" not in "".join(parts.read(n).decode() for n in parts.namelist() if n.startswith("xl/worksheets/"))
    rows = list(csv.DictReader(io.StringIO((folder / "certificate.csv").read_text())))
    assert {row["pose"] for row in rows} >= {f"'{HOSTILE}", "P2"}
    assert [float(row["value"]) for row in rows] == [f["value"] for f in figures]
    for row, figure in zip(rows, figures, strict=True):
        contributions = [float(v) for k, v in row.items() if k.startswith("contribution of ")]
        assert math.hypot(*contributions) == pytest.approx(figure["u"], rel=1e-9)


@pytest.mark.parametrize("text", ["=1", "+1", "-1", "@x", "\t=1", " =1", "＝1", "\r1"])
def test_what_a_spreadsheet_would_compute_begins_with_a_quote(text: str) -> None:
    assert harmless(text) == f"'{text}"
    assert harmless(f"P{text}") == f"P{text}"


def test_the_mat_file_has_results_and_contributions(folder: Path, figures: list[dict[str, Any]]) -> None:
    found = scipy.io.loadmat(folder / "certificate.mat", simplify_cells=True)
    np.testing.assert_array_equal(found["results"]["value"], [f["value"] for f in figures])
    np.testing.assert_allclose(np.linalg.norm(found["contributions"], axis=1), [f["u"] for f in figures], rtol=1e-9)
    assert found["contributions"].shape[1] == len(found["sources"])
    assert len(found["attained"]["time_s"]) == 6


def test_tables_are_made_again_and_compared(folder: Path, tmp_path: Path) -> None:
    assert verify(folder, printers=PRINTERS).exit_code == 0
    for name in ("certificate.xlsx", "certificate.csv", "certificate.mat"):
        content, printer = (folder / name).read_bytes(), PRINTERS[name]
        assert printer.close(content, content)
        assert printer.text(content) == printer.text(content)
        assert not printer.close(content, content[: len(content) // 2])
    with pytest.raises(ValueError, match="no workbook"):
        PRINTERS["certificate.xlsx"].text(b"PK")


@pytest.mark.skipif(shutil.which("soffice") is None, reason="LibreOffice is not installed")
def test_libreoffice_shows_the_same_numbers(folder: Path, figures: list[dict[str, Any]], tmp_path: Path) -> None:
    command = ["soffice", "--headless", "--convert-to", "csv", "--outdir", str(tmp_path), str(folder / "certificate.xlsx")]
    subprocess.run(command, check=True, timeout=120)
    rows = list(csv.DictReader(io.StringIO((tmp_path / "certificate.csv").read_text())))
    for row, figure in zip(rows, figures, strict=True):
        assert float(row["u95"]) == pytest.approx(figure["u95"], rel=1e-6)
