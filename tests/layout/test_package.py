"""What is shipped beside the code: the licence, the types, and bounds where a file format or a kernel depends on a package."""

import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from lmeasure.core import entry_points as extras

ROOT = Path(__file__).parents[2]
PIP = f"{sys.executable} -m pip install"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_the_licence_is_there_and_named() -> None:
    assert PROJECT["project"]["license"] == "Apache-2.0"
    (name,) = PROJECT["project"]["license-files"]
    assert "Apache License\n                           Version 2.0, January 2004" in (ROOT / name).read_text(encoding="utf-8")


BUILD = "import sys, setuptools.build_meta as m; m.build_wheel(sys.argv[1])"
COMMANDS = """
import sys, lmeasure
from lmeasure.cli.app import main
for line in ("--version --json", "init cell --template three-drums", "inspect cell/rig.toml", "key --out k"):
    sys.argv = ["lmeasure", *line.split()]
    try:
        main()
    except SystemExit as end:
        assert not end.code, line
print(lmeasure.__file__)
"""


def test_the_wheel_is_the_package_and_runs_outside_of_it(tmp_path: Path) -> None:
    """Without a compiler or anything else on the PATH; `benchmarks/installations.py` does so in empty environments of each Python."""
    source, installed, here = tmp_path / "source", tmp_path / "installed", tmp_path / "here"
    shutil.copytree(ROOT / "lmeasure", source / "lmeasure", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "MANIFEST.in", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    here.mkdir()
    subprocess.run([sys.executable, "-c", BUILD, str(tmp_path)], cwd=source, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(installed)
    shipped = {path.relative_to(installed) for path in (installed / "lmeasure").rglob("*") if path.is_file()}
    assert shipped == {path.relative_to(source) for path in (source / "lmeasure").rglob("*") if path.is_file()}
    env = {"PYTHONPATH": str(installed), "PATH": "", "HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", COMMANDS], cwd=here, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (here / "cell" / "rig.toml").exists()
    assert Path(done.stdout.splitlines()[-1]).is_relative_to(installed)


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
