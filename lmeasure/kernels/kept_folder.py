"""The folder of compiled code: one for each state of these sources, used only where no other user can have written it."""

import hashlib
import os
import stat
import sys
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"


def own_folder(path: Path) -> bool:
    """Return whether the folder exists or was made, and is the user's own: no other user may write in it."""
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.lstat()
        if not stat.S_ISDIR(found.st_mode) or not is_mine(found):
            return False
        if os.name != "nt" and found.st_mode & 0o077:
            path.chmod(0o700)
    except OSError:
        return False
    return os.access(path, os.W_OK | os.X_OK)


def is_mine(found: os.stat_result) -> bool:
    """Return whether a file or folder is this user's, and no other user may write it."""
    # Windows has no such owners and modes: there the folder lies in the user's profile
    return os.name == "nt" or (found.st_uid == os.geteuid() and not found.st_mode & 0o022)


def _folder() -> Path:
    here = Path(__file__).parent
    digest = hashlib.sha256()
    for source in [*sorted(here.glob("*.py")), here.parent / "core" / "status.py"]:  # compiled code holds the numbers of statuses
        digest.update(source.read_bytes())
    if sys.platform == "win32":
        root = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        root = Path.home() / "Library" / "Caches"
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return root / "lmeasure" / f"kernels-{digest.hexdigest()[:16]}"


if VARIABLE not in os.environ:
    os.environ[VARIABLE] = str(_folder())
