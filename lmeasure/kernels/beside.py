"""Compile in another process the kernels that this one computed uncompiled, so that the next process has them."""

import contextlib
import importlib
import os
import pickle
import subprocess
import sys
from pathlib import Path

from lmeasure.kernels.kept_folder import VARIABLE, own_folder
from lmeasure.kernels.uncompiled import wanted

CHILD = "from lmeasure.kernels import compile_wanted; compile_wanted()"


def compile_beside() -> None:
    """Start a process of the lowest priority that compiles the kernels that this one computed uncompiled, and do not wait for it."""
    if not wanted or not own_folder(Path(os.environ[VARIABLE])):
        return
    with contextlib.suppress(OSError):
        nothing = subprocess.DEVNULL
        child = subprocess.Popen(
            [sys.executable, "-c", CHILD], stdin=subprocess.PIPE, stdout=nothing, stderr=nothing, start_new_session=True
        )
        if child.stdin is not None:
            child.stdin.write(pickle.dumps(list(wanted.values())))
            child.stdin.close()


def compile_wanted() -> None:
    """Compile the kernels that standard input lists, unless another process already does."""
    from lmeasure.kernels.cache import KeptCode

    listed = pickle.load(sys.stdin.buffer)
    if hasattr(os, "nice"):
        os.nice(19)
        with contextlib.suppress(OSError):  # Linux weighs sessions before processes
            Path("/proc/self/autogroup").write_text("19", encoding="ascii")
    KeptCode.in_turn = False
    with (Path(os.environ[VARIABLE]) / "beside.lock").open("wb") as turn:
        with contextlib.suppress(ImportError):
            import fcntl

            try:
                fcntl.flock(turn, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                return
        for module, name, examples in listed:
            getattr(importlib.import_module(module), name).compile_for(examples)
