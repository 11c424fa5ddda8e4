"""A cell of six drums and runs in it, for the tests of the trajectory."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure.core import WORDS
from lmeasure.recording import Counts, Run
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.sensors import counts_from_poses, recorded_from_counts
from lmeasure.trajectory import Trajectory

FloatArray = NDArray[np.float64]

POINTS = {
    "B1": (-754.1, 292.9, 833.2), "B2": (1354.3, -63.4, 411.5), "B3": (401.6, -807.4, 1198.9), "B4": (110.0, -1283.6, -477.8),
    "B5": (537.0, -1183.0, 1360.0), "B6": (1312.0, 1347.0, 689.0),
}  # fmt: skip
TOOL = {"P1": [0.0, 150.0, 0.0], "P2": [-130.0, -75.0, 10.0], "P3": [130.0, -75.0, -10.0]}
PAIRS = (("B1", "P1"), ("B2", "P1"), ("B3", "P2"), ("B4", "P2"), ("B5", "P3"), ("B6", "P3"))
START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def observation_point(name: str, position: tuple[float, float, float], bits: int | None = 32) -> dict[str, Any]:
    """A point whose guide looks roughly at the origin, with a pulley and a drum that differ from point to point."""
    x, y, z = position
    number = int(name[1:])
    drum = {
        "counts_per_revolution": 6000, "count_length_mm": 0.012, "groove_pitch_mm": 0.8 + 0.1 * number,
        "tangent_length_mm": 140.0 + 15.0 * number, "axial_offset_mm": 20.0 + number, "count_sign": 1 if number % 2 else -1,
        "zero_exact": True,
    }  # fmt: skip
    # u points along (-cos a sin b, -cos a cos b, sin a): towards the origin, turned by some degrees
    alpha = np.degrees(np.arctan2(-z, np.hypot(x, y))) + 8.0
    beta = np.degrees(np.arctan2(x, y)) - 5.0
    return {
        "name": name, "position_mm": position, "guide_alpha_deg": float(alpha), "guide_beta_deg": float(beta),
        "pulley_radius_mm": 14.0 + 2.0 * number, "drum": drum | ({"counter_bits": bits} if bits else {}),
    }  # fmt: skip


def cell(bits: int | None = 32, **changes: Any) -> Rig:
    """Six drums around a cell, two cables to each corner of a triangle, zeroed exactly, as `record` does it; keyword arguments replace keys
    of the rig."""
    data: dict[str, Any] = {
        "schema": "lmeasure.rig/1",
        "unstated": "exact",
        "name": "cell",
        "observation_point": [observation_point(n, p, bits) for n, p in POINTS.items()],
        "tool": TOOL,
        "cable": [{"name": f"c{i}", "channel": f"ch{i}", "from": b, "to": p} for i, (b, p) in enumerate(PAIRS, 1)],
    }
    return rig_from_dict(data | changes)


def motion(n: int, rate_hz: float = 1000.0, reach_mm: float = 200.0, tilt_rad: float = 0.2) -> tuple[FloatArray, FloatArray]:
    """(times [s], (n, 7) poses) of a smooth motion that begins at `START`."""
    t = np.arange(n) / rate_hz
    w = 2.0 * np.pi * np.array([0.31, 0.43, 0.37])
    position = reach_mm * np.sin(np.outer(t, w)) * [1.0, -0.8, 0.6]
    rotation = Rotation.from_rotvec(tilt_rad * np.sin(np.outer(t, w[::-1])) * [0.9, 0.7, -1.0])
    return t, np.column_stack([position, rotation.as_quat()])


def record(rig: Rig, times: FloatArray, poses: FloatArray, start: FloatArray = START, exact: bool = False) -> Run:
    """A run as the rig's encoders would record it, in as many passes as the rig has; exact counts are not rounded."""
    passes = []
    for number in range(1, rig.passes + 1):
        cables = rig.cables_of(number)
        counts = counts_from_poses(rig, poses, start, cables)
        signs = np.array([rig.point(c.from_point).drum.count_sign for c in cables])
        recorded = counts * signs if exact else recorded_from_counts(rig, counts, cables)
        passes.append(Counts(times, tuple(c.channel for c in cables), recorded, source=f"pass{number}"))
    return Run(rig, start, tuple(passes), unstated="exact")


def with_recorded(run: Run, recorded: FloatArray) -> Run:
    """The same run with other recorded counts in its first pass."""
    return replace(run, passes=(replace(run.passes[0], recorded=recorded), *run.passes[1:]))


def position_error(poses: FloatArray, truth: FloatArray) -> FloatArray:
    """(n,) distances [mm]."""
    return np.asarray(np.linalg.norm(poses[:, :3] - truth[:, :3], axis=1))


def rotation_error(poses: FloatArray, truth: FloatArray) -> FloatArray:
    """(n,) angles [rad]."""
    return np.asarray((Rotation.from_quat(poses[:, 3:]) * Rotation.from_quat(truth[:, 3:]).inv()).magnitude())


def words(trajectory: Trajectory) -> list[str]:
    """What the samples are, in words."""
    return [WORDS[status] for status in trajectory.status]
