"""Packages that only some files need, and how to get them; versions of what is installed."""

import sys
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path


def version_of(name: str) -> str:
    """Of a package as it was installed; "unknown" where what tells it was removed, as packagers do."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"


def how_to_install(extra: str) -> str:
    """The command that installs what an extra of this program needs: from this program's folder, which no index has, or, where it is
    installed without one, the packages themselves."""
    installs = _installer()
    folder = Path(__file__).resolve().parents[2]
    if (folder / "pyproject.toml").is_file():
        return f"{installs} '{folder}[{extra}]'"
    try:
        stated = [text.replace("'", '"').partition(";") for text in requires("lmeasure") or []]
    except PackageNotFoundError:
        stated = []
    wanted = [package.strip() for package, _, condition in stated if condition.endswith(f'extra == "{extra}"')]
    return f"{installs} " + " ".join(f"'{text}'" for text in wanted) if wanted else f"install lmeasure with its extra {extra}"


def _installer() -> str:
    """What installs into the environment that runs here: the `pip` of the path may be another's, and uv makes environments without one."""
    if find_spec("pip") is None:
        return f"uv pip install --python {sys.executable}"
    return f"{sys.executable} -m pip install"
