"""Compiled now or loaded from what an earlier process compiled: the same digits."""

import importlib
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

from lmeasure import kernels

RECONSTRUCT = """
import hashlib
import numpy as np
from lmeasure.kernels.lanes import follow
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path
from lmeasure.lengths import lengths_from_counts
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
