"""Compiled now or loaded from what an earlier process compiled: the same digits."""

import importlib
import importlib.util
import os
import pickle
import pkgutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from lmeasure import kernels
from lmeasure.kernels import decorators
from lmeasure.kernels.kept_folder import own_folder

RECONSTRUCT = """
import hashlib
import numpy as np
from lmeasure.kernels import follow_lanes as follow
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path
from lmeasure.sensors import lengths_from_counts
home = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
there = np.array([150.0, 80.0, -120.0, 0.1, 0.0, 0.0, 0.99**0.5])
time_s, poses = smooth_path(home, [Leg(there, 300.0, 1.0, 0.5), Leg(home, 300.0, 1.0, 0.5)], 1000.0)
rig = cell_rig(0)
run = simulate_run(rig, time_s, poses, 0.0, np.random.default_rng(0)).run
lengths = lengths_from_counts(run)
u = np.full(6, 0.0035)
found = follow(rig.cable_rows(), home, np.concatenate([home, np.zeros(7)]), lengths.change_mm, lengths.flags, u)
assert np.isfinite(found[0]).all()
print(hashlib.sha256(found[0].tobytes()).hexdigest())
"""


def test_a_kernel_is_inlined_into_those_that_call_it() -> None:
    found = [
        value
        for module in pkgutil.iter_modules(kernels.__path__)
        for value in vars(importlib.import_module(f"{kernels.__name__}.{module.name}")).values()
        if hasattr(value, "py_func") and value.targetoptions.get("fastmath")  # a strict kernel has one set of digits only
    ]
    assert len(found) > 50
    callees = {id(f.py_func.__globals__.get(name)) for f in found for name in f.py_func.__code__.co_names}
    apart = {f.py_func.__qualname__ for f in found if id(f) in callees and not f.targetoptions.get("forceinline")}
    assert apart == set()


@pytest.mark.slow
def test_a_process_that_compiles_gives_the_digits_of_one_that_loads(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    outputs = [
        subprocess.run([sys.executable, "-c", RECONSTRUCT], env=environment, capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    ]
    assert outputs[0] == outputs[1]


ONE = """
import numpy as np
from lmeasure.kernels import rests
found = rests.dispatcher(np.arange(5.0), np.array([1.0, 2.0, 2.0, 2.0, 3.0]), 1.5)
assert found.tolist() == [[1, 3]], found
print("hits", sum(rests.stats.cache_hits.values()), "misses", sum(rests.stats.cache_misses.values()))
"""


def one(folder: Path, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", ONE], env=os.environ | {"NUMBA_CACHE_DIR": str(folder)} | environment, capture_output=True,
        text=True, check=True,
    )  # fmt: skip
    assert done.stderr == ""
    return done.stdout.strip()


def here(folder: Path) -> str:
    """The same by a copy of the module in this process, which need not load the libraries again."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(decorators, "_KEEPS", own_folder(folder))
        patch.setattr(numba.config, "CACHE_DIR", str(folder))
        spec = importlib.util.find_spec("lmeasure.kernels.counter")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        found = module.rests.dispatcher(np.arange(5.0), np.array([1.0, 2.0, 2.0, 2.0, 3.0]), 1.5)
    assert found.tolist() == [[1, 3]]
    return f"hits {sum(module.rests.stats.cache_hits.values())} misses {sum(module.rests.stats.cache_misses.values())}"


class Payload:
    """What is unpickled makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


def test_what_was_planted_among_the_kept_code_does_not_run(tmp_path: Path) -> None:
    """Numba unpickles what it finds. Here everything stands behind a digest, in a folder of the user's own."""
    folder, ran = tmp_path / "kept", tmp_path / "ran"
    assert one(folder) == "hits 0 misses 1"
    assert folder.stat().st_mode & 0o777 == 0o700
    assert here(folder) == "hits 1 misses 0"
    kept = [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".lock"]
    assert {path.suffix for path in kept} == {".nbi", ".nbc"}
    for path in kept:
        path.write_bytes(pickle.dumps(numba.__version__) + pickle.dumps(Payload(ran)))
    assert one(folder) == "hits 0 misses 1"
    assert not ran.exists()
    assert here(folder) == "hits 1 misses 0"  # kept again
    for path in kept:
        content = path.read_bytes()
        path.write_bytes(content[:-20] if path.suffix == ".nbi" else content[:300] + b"\xff" + content[301:])
        assert here(folder) == "hits 0 misses 1", path


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make files of another user")
@pytest.mark.parametrize("what", ["folder", "files"])
def test_code_of_another_user_is_not_loaded(tmp_path: Path, what: str) -> None:
    folder = tmp_path / "kept"
    here(folder)
    for path in [folder] if what == "folder" else [p for p in folder.rglob("*") if p.is_file()]:
        os.chown(path, 65534, 65534)
    assert here(folder) == "hits 0 misses 1"


def test_where_nothing_can_be_kept_it_is_compiled(tmp_path: Path) -> None:
    open_to_all = tmp_path / "open"
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    (tmp_path / "file").write_text("")
    linked = tmp_path / "linked"
    linked.symlink_to(open_to_all)
    for folder, process in ((open_to_all, one), (tmp_path / "file" / "below", here), (linked, here)):
        assert process(folder) == "hits 0 misses 1"
    assert list(open_to_all.iterdir()) == []


def test_a_full_disk_costs_the_compile_time_only(tmp_path: Path) -> None:
    """Files of no size at all stand for the disk: what is kept cannot be written."""
    limited = (
        f"import resource, signal\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN)\nresource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))\n{ONE}"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kept"), "PYTHONDONTWRITEBYTECODE": "1"}
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", limited], env=environment, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == "hits 0 misses 1"


TOGETHER = """
import sys, time
from pathlib import Path
import numpy as np
from lmeasure.kernels import compilation
from lmeasure.kernels import rests
Path(sys.argv[1]).touch()
while not all(map(Path.exists, map(Path, sys.argv[1:]))):
    time.sleep(0.001)
rests.dispatcher(np.arange(5.0), np.array([1.0, 2.0, 2.0, 2.0, 3.0]), 1.5)
print(*compilation.names)
"""


@pytest.mark.skipif(os.name == "nt", reason="each compiles for itself there")
def test_processes_that_start_together_compile_a_kernel_once(tmp_path: Path) -> None:
    ready = [str(tmp_path / name) for name in "ab"]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    started = [
        subprocess.Popen([sys.executable, "-c", TOGETHER, *order], env=environment, stdout=subprocess.PIPE, text=True)
        for order in (ready, ready[::-1])
    ]
    said = [process.communicate(timeout=120)[0].split() for process in started]
    assert sorted(map(bool, said)) == [False, True]
