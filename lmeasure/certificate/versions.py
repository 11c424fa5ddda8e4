"""The method and the environment that computed the results: the same environment gives the same digits, another may differ in the last
ones.
"""

import hashlib
import platform
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import llvmlite.binding

from lmeasure.core import plug_in_version, version_of

METHOD = 1
"""Raised whenever the same inputs give other results, or the same results another verdict."""


LIBRARIES = ("numpy", "scipy", "numba", "llvmlite", "pandas", "pyarrow", "pydantic", "plotly", "typst", "segno")

PLUG_IN = "plug-in "


@cache
def sources_sha256() -> str:
    """SHA-256 over the names and digests of this package's own sources."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    sources = [path for kind in ("py", "typ", "po", "css", "js") for path in root.rglob(f"*.{kind}")]
    for path in sorted(sources, key=lambda p: p.relative_to(root).as_posix()):
        digest.update(f"{path.relative_to(root).as_posix()} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()


def environment(added: Iterable[str] = ()) -> dict[str, str]:
    """Versions of the program, Python and the libraries that compute or print, and the processor kernels are compiled for.

    added names the characteristics that other packages add: each has the version of its package under PLUG_IN and its name.
    """
    return {
        "lmeasure": version_of("lmeasure"),
        "lmeasure sources": sources_sha256(),
        "python": platform.python_version(),
        **{name: version_of(name) for name in LIBRARIES},
        "system": f"{platform.system()} {platform.machine()}",
        "processor": llvmlite.binding.get_host_cpu_name(),
        **{f"{PLUG_IN}{name}": plug_in_version("lmeasure.characteristics", name) for name in added},
    }


def added_in(stated: Iterable[str]) -> list[str]:
    """Return the characteristics of other packages that a certificate's environment names."""
    return [key.removeprefix(PLUG_IN) for key in stated if key.startswith(PLUG_IN)]
