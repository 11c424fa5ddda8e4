"""With what the figures were computed: the same environment gives the same digits, another may differ in the last ones."""

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import llvmlite.binding

LIBRARIES = ("numpy", "scipy", "numba", "llvmlite", "pandas", "pyarrow", "pydantic", "plotly", "typst", "segno")


@cache
def sources_sha256() -> str:
    """SHA-256 over the names and digests of this package's own sources."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    sources = [path for kind in ("py", "typ", "po", "css", "js") for path in root.rglob(f"*.{kind}")]
    for path in sorted(sources, key=lambda p: p.relative_to(root).as_posix()):
        digest.update(f"{path.relative_to(root).as_posix()} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()


def _version(name: str) -> str:
    """Of a library as it was installed; "unknown" where what tells it was removed, as packagers do."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"


def environment() -> dict[str, str]:
    """Versions of the program, Python and the libraries that compute or print, and the processor kernels are compiled for."""
    return {
        "lmeasure": _version("lmeasure"),
        "lmeasure sources": sources_sha256(),
        "python": platform.python_version(),
        **{name: _version(name) for name in LIBRARIES},
        "system": f"{platform.system()} {platform.machine()}",
        "processor": llvmlite.binding.get_host_cpu_name(),
    }
