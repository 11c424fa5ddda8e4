"""The notebooks run from their folder, and are those that docs/make_notebooks.py writes. A reader's kernel runs them in
`tests/journeys/test_journey_of_a_researcher.py`."""

import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import nbformat
import pytest
from IPython.core.displaypub import CapturingDisplayPublisher
from IPython.core.interactiveshell import InteractiveShell

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_runs_and_shows_something(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process, whose kernels are loaded."""
    (tmp_path / "docs" / "notebooks").mkdir(parents=True)
    shutil.copytree(ROOT / "tests" / "authorities" / "truth" / "cell-run", tmp_path / "tests" / "authorities" / "truth" / "cell-run")
    monkeypatch.chdir(tmp_path / "docs" / "notebooks")
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    shell: Any = cast("Any", InteractiveShell)(user_module=ModuleType("notebook"))
    shell.display_pub = cast("Any", CapturingDisplayPublisher)()
    monkeypatch.setattr(InteractiveShell, "_instance", shell)  # to which a figure shows itself
    kinds: set[str] = set()
    for cell in notebook.cells:
        if cell.cell_type == "code":
            done = shell.run_cell(cell.source)
            done.raise_error()
            kinds |= set(shell.display_formatter.format(done.result)[0])
    kinds |= {kind for shown in shell.display_pub.outputs for kind in shown["data"]}
    assert {"text/html", "application/vnd.plotly.v1+json"} <= kinds


def test_notebooks_are_written_from_their_source_and_hold_no_output(tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(ROOT / "docs" / "make_notebooks.py"), str(tmp_path)], check=True)
    assert [p.name for p in NOTEBOOKS] == sorted(p.name for p in tmp_path.iterdir())
    assert len(NOTEBOOKS) == 3
    for path in NOTEBOOKS:
        assert path.read_bytes() == (tmp_path / path.name).read_bytes()
        assert not any(cell.get("outputs") for cell in nbformat.read(path, as_version=4).cells)
