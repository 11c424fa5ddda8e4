"""A PostgreSQL server of a test: its own data, a Unix socket and no port; an unprivileged user runs it."""

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

USER = "nobody"


def programs() -> Path | None:
    """Return the folder of the server's programs, which is often not in the path."""
    found = shutil.which("initdb")
    folders = [Path(found).resolve().parent] if found else sorted(Path("/usr/lib/postgresql").glob("*/bin"))
    return next((folder for folder in reversed(folders) if (folder / "postgres").is_file()), None)


@contextmanager
def postgresql() -> Iterator[str]:
    """Give the SQLAlchemy URL of an empty database; the test is skipped where there is no server."""
    folder = programs()
    if folder is None:
        pytest.skip("PostgreSQL is not installed")
    # the path of a socket has at most 107 bytes
    home = Path(tempfile.mkdtemp(prefix="pg", dir="/tmp"))
    user = USER if os.getuid() == 0 else None  # the server refuses to run as root
    if user is not None:
        shutil.chown(home, user)
    quiet: dict[str, Any] = {"cwd": home, "user": user, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    server = None
    try:
        subprocess.run([folder / "initdb", "-D", str(home / "data"), "-U", "lab", "-A", "trust", "--no-sync"], check=True, **quiet)
        words = ["-D", str(home / "data"), "-k", str(home), "-c", "listen_addresses=", "-c", "fsync=off"]
        server = subprocess.Popen([folder / "postgres", *words], **quiet)
        until = time.monotonic() + 30.0
        ready = [str(folder / "pg_isready"), "-h", str(home), "-q"]
        while subprocess.run(ready, check=False).returncode:
            assert time.monotonic() < until
            assert server.poll() is None
            time.sleep(0.05)
        yield f"postgresql+psycopg://lab@/postgres?host={home}"
    finally:
        if server is not None:
            server.terminate()
            server.wait(30)
        shutil.rmtree(home, ignore_errors=True)
