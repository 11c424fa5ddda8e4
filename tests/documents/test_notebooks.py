"""The notebooks run from their folder, as a reader would run them, and are those that docs/make_notebooks.py writes."""

import shutil
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_runs_and_shows_something(path: Path, tmp_path: Path) -> None:
    here = tmp_path / "docs" / "notebooks"
    here.mkdir(parents=True)
    shutil.copytree(ROOT / "tests" / "authorities" / "truth" / "cell-run", tmp_path / "tests" / "authorities" / "truth" / "cell-run")
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    NotebookClient(notebook, timeout=240, kernel_name="python3", resources={"metadata": {"path": here}}).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert not [output for output in shown if output["output_type"] == "error"]
    kinds = {kind for output in shown for kind in output.get("data", {})}
    assert {"text/html", "application/vnd.plotly.v1+json"} <= kinds


def test_notebooks_are_written_from_their_source_and_hold_no_output(tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(ROOT / "docs" / "make_notebooks.py"), str(tmp_path)], check=True)
    assert [p.name for p in NOTEBOOKS] == sorted(p.name for p in tmp_path.iterdir())
    assert len(NOTEBOOKS) == 3
    for path in NOTEBOOKS:
        assert path.read_bytes() == (tmp_path / path.name).read_bytes()
        assert not any(cell.get("outputs") for cell in nbformat.read(path, as_version=4).cells)
