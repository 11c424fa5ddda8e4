"""Settings of Sphinx for the documentation site. `python3 run.py docs` builds it; the sources are the folder above this one."""

import os
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs"))
os.environ["LANGUAGE"] = "en"  # of the help of commands

import generated_pages  # noqa: E402 - it lies in this folder

import lmeasure  # noqa: E402

project, author, release = "lmeasure", "The lmeasure developers", lmeasure.__version__
copyright = "the lmeasure developers, Apache-2.0"  # noqa: A001 - Sphinx' name
root_doc = "docs/README"
include_patterns = list(generated_pages.PAGES)
exclude_patterns = [".*", "build", "lmeasure", "tests", "**/__pycache__", "*.egg-info", "datasets", "calibration"]
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "sphinx_copybutton", "sphinx_design"]

myst_enable_extensions = ["deflist", "attrs_inline"]
myst_heading_anchors = 4
suppress_warnings = ["myst.header"]  # some pages of results skip a level
copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True
autodoc_typehints = "none"  # the sections of each docstring name types where they help
default_role = "literal"  # single backticks of docstrings are code, as in Markdown
autodoc_member_order = "bysource"
numpydoc_show_class_members = False

html_theme = "furo"
html_title = f"lmeasure {release}"
html_copy_source = False
html_show_sphinx = False
html_static_path = [str(ROOT / "docs" / "site.css")]
html_css_files = ["site.css"]
html_theme_options = {"top_of_page_buttons": [], "navigation_with_keys": True}


def add_generated(_app: Any, page: str, source: list[str]) -> None:
    """Put the toctree of an index page and the generated parts of a reference page into its source."""
    source[0] = generated_pages.completed(page, source[0])


def without_signature(_app: Any, what: str, *_rest: Any) -> tuple[str, str] | None:
    """Omit the constructor's arguments of a class: its fields follow, one by one."""
    return ("", "") if what == "class" else None


def redirect(app: Any, error: Exception | None) -> None:
    """Let the site's folder open at its first page."""
    if error is None:
        page = f'<!doctype html><meta charset="utf-8"><title>lmeasure</title><meta http-equiv="refresh" content="0; url={root_doc}.html">\n'
        (Path(app.outdir) / "index.html").write_text(page, encoding="utf-8")


def setup(app: Any) -> None:
    """Connect the functions above."""
    app.connect("source-read", add_generated)
    app.connect("autodoc-process-signature", without_signature)
    app.connect("build-finished", redirect)
