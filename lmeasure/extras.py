"""Packages that only some files need, and how to get them."""

from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path


def how_to_install(extra: str) -> str:
    """The command that installs what an extra of this program needs: from this program's folder, which no index has, or, where it is
    installed without one, the packages themselves."""
    folder = Path(__file__).resolve().parents[1]
    if (folder / "pyproject.toml").is_file():
        return f"pip install '{folder}[{extra}]'"
    try:
        stated = [text.replace("'", '"').partition(";") for text in requires("lmeasure") or []]
    except PackageNotFoundError:
        stated = []
    wanted = [package.strip() for package, _, condition in stated if condition.endswith(f'extra == "{extra}"')]
    return "pip install " + " ".join(f"'{text}'" for text in wanted) if wanted else f"install lmeasure with its extra {extra}"
