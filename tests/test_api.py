"""The public names of the package: all there, all lazy, all documented."""

import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import lmeasure


def test_every_public_name_is_there_and_documented() -> None:
    assert lmeasure.__all__ == sorted(lmeasure.__all__)
    for name in lmeasure.__all__:
        assert getattr(lmeasure, name).__doc__, name
    assert set(lmeasure.__all__) <= set(dir(lmeasure))
    assert set(lmeasure.__all__) == {*lmeasure._HOME, "LMeasureError"}


def test_version_is_that_of_the_installed_package() -> None:
    """That of the project's file, from which the package was installed."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert lmeasure.__version__ == version("lmeasure") == project["version"]


def test_a_name_that_is_not_there() -> None:
    assert not hasattr(lmeasure, "measure")


def test_import_brings_nothing_heavy() -> None:
    heavy = "{'numpy', 'scipy', 'pandas', 'pyarrow', 'numba', 'pydantic', 'rerun', 'plotly', 'can', 'xarray'}"
    code = f"import sys, lmeasure, lmeasure.cli; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
