"""What is shipped beside the code: the licence, the types, and bounds where a file format or a kernel depends on a package."""

import re
import sys
import tomllib
from pathlib import Path

import pytest

from lmeasure.core import packages as extras

ROOT = Path(__file__).parents[2]
PIP = f"{sys.executable} -m pip install"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_the_licence_is_there_and_named() -> None:
    assert PROJECT["project"]["license"] == "Apache-2.0"
    (name,) = PROJECT["project"]["license-files"]
    assert "Apache License\n                           Version 2.0, January 2004" in (ROOT / name).read_text(encoding="utf-8")


def test_types_faces_and_catalogues_are_shipped() -> None:
    shipped = PROJECT["tool"]["setuptools"]["package-data"]
    places = [(ROOT.joinpath(*package.split(".")), name) for package, patterns in shipped.items() for name in patterns]
    found = {path for folder, name in places for path in folder.glob(name)}
    package = ROOT / "lmeasure"
    assert found >= {package / "py.typed", *(path for kind in ("pyi", "po", "json", "npz") for path in package.rglob(f"*.{kind}"))}


def test_packages_that_a_format_or_a_kernel_depends_on_are_bounded() -> None:
    stated = {re.split(r"[\[<>=]", text)[0]: text for text in PROJECT["project"]["dependencies"]}
    for name in ("cantools", "h5netcdf", "h5py", "numba", "numpy", "python-can", "rerun-sdk", "typst"):
        assert "<" in stated[name], name


def test_hints_name_the_folder_or_the_packages_and_nothing_that_no_index_has(monkeypatch: pytest.MonkeyPatch) -> None:
    for extra, packages in PROJECT["project"]["optional-dependencies"].items():
        assert extras.how_to_install(extra) == f"{PIP} '{ROOT}[{extra}]'"
        assert packages
    stated = ["numpy>=2", 'mcap>=1.2; extra == "ros"', "asammdf>=8.0; extra == 'mf4'"]
    monkeypatch.setattr(extras, "requires", lambda name: stated)
    monkeypatch.setattr(extras, "__file__", "/site-packages/lmeasure/extras.py")
    assert extras.how_to_install("ros") == f"{PIP} 'mcap>=1.2'"
    assert extras.how_to_install("mf4") == f"{PIP} 'asammdf>=8.0'"
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    assert extras.how_to_install("mf4") == f"uv pip install --python {sys.executable} 'asammdf>=8.0'"
