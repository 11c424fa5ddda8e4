"""The reference of the Python names, from their docstrings: python docs/make_api.py FOLDER writes pages that need nothing else."""

import sys
from pathlib import Path

import pdoc.render
from pdoc.doc import Module

import lmeasure


def write_api(folder: Path) -> Path:
    """Write lmeasure.html, with every name of the package, and return its path."""
    for name in lmeasure.__all__:
        getattr(lmeasure, name)  # names are loaded when they are first used
    pdoc.render.configure(docformat="restructuredtext", show_source=False, search=False, footer_text=f"lmeasure {lmeasure.__version__}")
    module = Module(lmeasure)
    page = pdoc.render.html_module(module, all_modules={"lmeasure": module})
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "lmeasure.html"
    path.write_text(page, encoding="utf-8")
    return path


if __name__ == "__main__":
    print(write_api(Path(sys.argv[1])))
