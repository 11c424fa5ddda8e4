"""The NumPy twin gives what the kernels give, or nothing; and a short log compiles none of them."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from cells import START, FloatArray, cell, motion, record
from scipy.spatial.transform import Rotation
from screw_poses import angles_at

from lmeasure.core import Status
from lmeasure.kernels import screw
from lmeasure.recording import write_run
from lmeasure.rig import Rig
from lmeasure.sensors import span_lengths
from lmeasure.trajectory.reconstruction import screw_method

U = np.full(6, 0.0035)


def changes(rig: Rig, poses: FloatArray, noise_mm: float = 0.0) -> FloatArray:
    lengths = span_lengths(rig, poses) - span_lengths(rig, START[None])
    return np.asarray(lengths + np.random.default_rng(0).normal(0.0, 1.0, lengths.shape) * noise_mm)


def follow(rig: Rig, change: FloatArray, flags: np.ndarray | None = None) -> tuple[screw_method.Followed | None, FloatArray]:
    flags = np.zeros(len(change), np.int64) if flags is None else flags
    state = screw.new_state(START)
    return screw_method.follow_together(rig.cable_rows(), START, state, change, flags=flags), state


def test_where_a_run_has_got_to_is_the_kernels() -> None:
    rig = cell()
    change = changes(rig, motion(1000)[1], 0.5)
    found, state = follow(rig, change)
    there = screw.new_state(START)
    expected = screw.resume_screw(rig.cable_rows(), START, there, change, np.zeros(len(change), np.int64), U)
    assert found is not None
    np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=1e-10)
    np.testing.assert_allclose(state, there, rtol=0, atol=1e-9)


def test_what_is_not_plain_is_left_to_the_kernels() -> None:
    rig = cell()
    change = changes(rig, motion(300)[1])
    nothing = np.full(300, Status.GAP)
    assert follow(rig, change, nothing)[0] is None
    jumped = change.copy()
    jumped[150:, 2] += 25.0  # farther from one sample to the next than one may start
    found, state = follow(rig, jumped)
    assert found is None
    np.testing.assert_array_equal(state, screw.new_state(START))
    lost = screw.new_state(START)
    lost[screw.LOST] = 1.0
    assert screw_method.follow_together(rig.cable_rows(), START, lost, change, flags=np.zeros(300, np.int64)) is None
    contradicting = change.copy()
    contradicting[200, 0] = np.nan
    assert follow(rig, contradicting)[0] is None


def test_beyond_75_degrees_the_kernels_decide() -> None:
    """A turn about the vertical towards the singular pose: as far as 75 degrees and no farther."""
    rig = cell()
    turned = np.column_stack([np.zeros((2000, 3)), Rotation.from_rotvec(np.linspace(0, 1.6, 2000)[:, None] * [0, 0, 1]).as_quat()])
    angles = np.degrees(angles_at(rig.cable_rows(), turned).max(axis=1))
    beyond = int(np.argmax(angles > 75.0))
    assert beyond > 100
    change = changes(rig, turned)
    assert follow(rig, change[:beyond])[0] is not None
    assert follow(rig, change[: beyond + 1])[0] is None


SHORT = """
import sys
from lmeasure.cli.app import main
try:
    main()
except SystemExit as end:
    assert not end.code
heavy = ("numba", "pandas", "pyarrow.compute", "scipy.linalg", "scipy.ndimage", "scipy.spatial", "scipy.special", "numpy.random")
print([name for name in heavy if name in sys.modules])
"""


def test_a_short_log_loads_nothing_heavy(tmp_path: Path) -> None:
    write_run(tmp_path / "run", record(cell(), *motion(500)))
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    arguments = ["reconstruct", str(tmp_path / "run"), "--out", str(tmp_path / "out.parquet")]
    done = subprocess.run([sys.executable, "-c", SHORT, *arguments], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.splitlines()[-1] == "[]"
