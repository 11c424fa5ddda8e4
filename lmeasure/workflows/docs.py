"""The documentation in a browser."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, ClassVar

from lmeasure.core import LMeasureError, SettingsError
from lmeasure.text import message
from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.settings import BROWSER, Asked, option

SOURCE = Path(__file__).parents[2] / "docs"
"""Folder of the pages in a copy of the repository; an installed package has none."""


class Settings(Asked):
    """Settings of `lmeasure docs`."""

    NEXT: ClassVar[str] = "demo"
    page: Annotated[
        str | None, option("Page to open, such as zone or troubleshooting; default the first.", metavar="PAGE", positional=True)
    ] = None
    browser: Annotated[bool, BROWSER] = True


@workflow
def run(settings: Settings, progress: Progress = silent) -> Result[Path]:
    """Build the site where its pages have changed, and open a page of it."""
    pages = sorted(SOURCE.glob("*.md"))
    if not (SOURCE / "build_site.py").is_file():
        raise LMeasureError(message("error.docs_not_installed"))
    names = [page.stem for page in pages if page.stem != "README"]
    if settings.page is not None and settings.page not in names:
        raise SettingsError("page", message("error.is_not_one_of_2", name=settings.page, templates=", ".join(names)))
    site = SOURCE.parent / "build" / "docs"
    first = site / "index.html"
    if not first.is_file() or first.stat().st_mtime < max(page.stat().st_mtime for page in (*pages, SOURCE.parent / "README.md")):
        if find_spec("sphinx") is None:
            raise LMeasureError(message("error.docs_not_built"))
        progress(0.0, "docs")
        done = subprocess.run(
            [sys.executable, SOURCE / "build_site.py", "--no-browser"],
            capture_output=True,
            text=True,
            check=False,
            stdin=subprocess.DEVNULL,
        )
        if done.returncode:
            raise LMeasureError(message("error.docs_failed", line=((done.stderr or done.stdout).strip().splitlines() or [""])[-1]))
    opened = first if settings.page is None else site / "docs" / f"{settings.page}.html"
    return Result(opened, (message("workflow.docs.page", page=opened),), page=opened)
