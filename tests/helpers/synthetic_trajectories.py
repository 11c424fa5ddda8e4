"""Trajectories made sample by sample for tests of certification, with errors of a stated law or of none."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure.core import symmetric_root
from lmeasure.iso9283 import Evaluation
from lmeasure.iso9283.characteristic import Characteristic
from lmeasure.trajectory import PoseErrors, Trajectory

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

UNIT = (0.0, 0.0, 0.0, 1.0)
PLACES = {"P1": (0.0, 0.0, 0.0), "P2": (200.0, 0.0, 0.0), "P3": (0.0, 150.0, 0.0), "P4": (0.0, 0.0, 100.0)}


class StatedErrors:
    """Errors of the same law at every sample: covariance (6, 6) of what is independent - rounded: it is that of counts -, factors (6, K) of
    what the run shares."""

    def __init__(self, random: FloatArray | None = None, shared: FloatArray | None = None, rounded: bool = False) -> None:
        self.rounded = rounded
        self.random = np.zeros((6, 6)) if random is None else random
        self.shared = np.zeros((6, 0)) if shared is None else shared

    def at(self, trajectory: Trajectory, samples: IntArray) -> tuple[PoseErrors, str]:
        """See `lmeasure.iso9283.ErrorModel`."""
        n = len(samples)
        return PoseErrors.of(
            symmetric_root(np.tile(self.random, (n, 1, 1))), np.tile(self.shared, (n, 1, 1)), rounded=self.rounded
        ), "as stated"


def trajectory_of(time_s: FloatArray, position: FloatArray, turn: FloatArray | None = None, angle_deg: float = 30.0) -> Trajectory:
    """A trajectory through positions (n, 3) [mm] with rotation vectors (n, 3) [rad], all ok, no uncertainty of its own."""
    n = len(time_s)
    turn = np.zeros((n, 3)) if turn is None else turn
    poses = np.column_stack([position, Rotation.from_rotvec(turn).as_quat()])
    zero, none, text = np.zeros(n), np.zeros((n, 6, 6)), np.full(n, "", dtype=np.object_)
    return Trajectory(
        time_s, poses, zero, zero.astype(np.int64), zero.astype(np.int64), text, text, np.full(n, angle_deg), none, none, "as stated"
    )


def dwells(places: FloatArray, rate_hz: float = 100.0) -> tuple[FloatArray, FloatArray, list[tuple[float, float]]]:
    """Times (n,) [s] and positions (n, 3) of a robot that jumps to each place (k, 3) and rests there for 0.5 s after 0.5 s of way, and the
    windows of the rests."""
    k = len(places)
    time_s = np.arange(int(k * rate_hz)) / rate_hz
    number = np.minimum(time_s.astype(int), k - 1)
    part = np.clip(2.0 * (time_s - number), 0.0, 1.0)[:, None]
    before = np.concatenate([places[:1], places[:-1]])
    return time_s, before[number] + part * (places[number] - before[number]), [(i + 0.5, i + 0.99) for i in range(k)]


def synthetic_campaign(
    offset: FloatArray, scatter: float, cycles: int = 30, seed: int = 1, names: tuple[str, ...] = ("P1", "P2")
) -> tuple[Any, Any]:
    """A trajectory of dwells at poses in turn, off by offset and scattered, and the program as a dictionary."""
    rng = np.random.default_rng(seed)
    places = np.array([np.array(PLACES[n]) + offset + scatter * rng.normal(size=3) for _ in range(cycles) for n in names])
    time_s, position, windows = dwells(places)
    poses = [
        {"name": n, "position_mm": PLACES[n], "quaternion_xyzw": UNIT, "windows_s": windows[i :: len(names)]} for i, n in enumerate(names)
    ]
    return trajectory_of(time_s, position), {"schema": "lmeasure.program/1", "pose": poses}


def by_name(found: Evaluation) -> dict[tuple[str, str | None], Characteristic]:
    """Characteristics by name and pose."""
    return {(c.name, c.pose): c for c in found.characteristics}


def some_law(seed: int) -> FloatArray:
    """Some covariance (6, 6) of 1e-5 rad and 0.005 mm."""
    A = np.random.default_rng(seed).normal(size=(6, 6)) * np.repeat([1e-5, 0.005], 3)[:, None]
    return np.asarray(A @ A.T / 6.0)
