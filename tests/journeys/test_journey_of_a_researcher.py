"""A researcher from README to a certificate and the three notebooks, in an empty folder; `pytest -s -m slow` shows what each step took.
README's lines are run one after the other, and `lmeasure simulate` gives the same run as files."""

import ast
import shutil
import time
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient
from test_journeys import said

import lmeasure as lm
from lmeasure.recording import read_run

ROOT = Path(__file__).parents[2]
CELL = Path("tests/authorities/truth/cell-run")
pytestmark = pytest.mark.slow


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, but for the rig that README and the notebooks take."""
    shutil.copytree(ROOT / CELL, tmp_path / CELL)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_readme_line_by_line(empty: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    here: dict[str, Any] = {}
    for statement in ast.parse(page.split("```python\n")[1].split("```")[0]).body:
        words = ast.unparse(statement)
        begin = time.monotonic()
        exec(words, here)
        if (took := time.monotonic() - begin) > 0.05:
            with capsys.disabled():
                print(f"\n{words[:60]}: {took:.1f} s", end="")
    # what was measured is where it was simulated, within what is stated
    truth, found = here["run"].run.poses, here["trajectory"]
    off = np.linalg.norm(found.poses[:, :3] - truth[:, :3], axis=1)
    stated = np.sqrt(np.trace((found.random + found.systematic)[:, 3:, 3:], axis1=1, axis2=2))
    assert np.sqrt(np.mean((off / stated) ** 2)) < 3.0
    assert np.all(off < 0.2)
    assert len(here["certificate"].content["characteristics"]) == 47
    assert lm.verify(here["certificate"]).differences == ()
    assert (empty / "zone.html").stat().st_size > 100_000
    assert (empty / "certificate" / "certificate.pdf").stat().st_size > 10_000


def test_the_same_as_files(empty: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    said(monkeypatch, capsys, "init", "cell", "--template", "six-cables")
    said(monkeypatch, capsys, "simulate", "cell/scenario.toml", "--out", "tried")
    said(monkeypatch, capsys, "calibrate", "tried/calibration", "--out", "calibrated")
    said(monkeypatch, capsys, "reconstruct", "tried", "--rig", "calibrated/rig.toml", "--out", "trajectory.parquet")
    made = lm.simulate("cell/scenario.toml")
    assert made.run is not None
    np.testing.assert_array_equal(read_run(Path("tried")).passes[0].recorded, made.run.run.passes[0].recorded)


@pytest.mark.parametrize("path", sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")), ids=lambda p: p.stem)
def test_a_notebook_cell_by_cell(path: Path, empty: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here = empty / "docs" / "notebooks"
    here.mkdir(parents=True)
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": here}})
    with client.setup_kernel():
        for number, cell in enumerate(notebook.cells):
            begin = time.monotonic()
            client.execute_cell(cell, number)
            if cell.cell_type == "code":
                with capsys.disabled():
                    print(f"\n{path.stem}: {cell.source.strip().splitlines()[0][:60]}: {time.monotonic() - begin:.1f} s", end="")
    assert not [o for cell in notebook.cells for o in cell.get("outputs", ()) if o["output_type"] == "error"]
