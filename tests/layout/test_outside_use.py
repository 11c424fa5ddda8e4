"""lmeasure as somebody else's program sees it: typed, named, described."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import lmeasure

ROOT = Path(__file__).parents[2]
SCRIPT = """import lmeasure as lm


def worst(folder: str) -> float:
    trajectory: lm.Trajectory = lm.reconstruct(folder)
    return float(trajectory.u.max())


def rig(path: str) -> list[str]:
    calibrated: lm.Calibration = lm.calibrate(path, solve=("position",))
    return [cable.name for cable in calibrated.rig.cable]


WRONG: int = lm.reconstruct("run")
"""


@pytest.mark.slow  # mypy reads the whole package, with an empty cache, in half a minute to a minute and a half
def test_a_strict_mypy_elsewhere_sees_the_types(tmp_path: Path) -> None:
    """`py.typed` is shipped: names have their types, and what is wrong is found, nothing else."""
    (tmp_path / "use.py").write_text(SCRIPT)
    # as an installed package is found, not by this project's settings
    code = f"import sys; sys.path.append({str(ROOT)!r}); from mypy.api import run; out = run(sys.argv[1:]); print(out[0], out[1])"
    words = ["--strict", "--config-file=", "--cache-dir", str(tmp_path / "cache"), "--follow-imports=silent"]
    words += ["--no-error-summary", "use.py"]
    environment = {"MYPYPATH": "", "PATH": ""}
    done = subprocess.run([sys.executable, "-c", code, *words], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    found = done.stdout.strip().splitlines()
    assert len(found) == 1, done.stdout
    assert found[0].startswith("use.py:14: error: Incompatible types in assignment")
    assert '"Trajectory"' in found[0]


def test_how_to_cite() -> None:
    lines = (ROOT / "CITATION.cff").read_text(encoding="utf-8").splitlines()
    cited = dict(line.split(": ", 1) for line in lines if ": " in line and not line.startswith(" "))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert (cited["version"], cited["license"]) == (lmeasure.__version__, project["license"])
    assert {"cff-version", "message", "title", "type"} <= set(cited)
    assert "authors:" in lines
