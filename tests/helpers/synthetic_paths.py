"""Commanded paths, and trajectories that run along them with known deviations."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from synthetic_trajectories import StatedErrors, trajectory_of

from lmeasure.iso9283 import CertificationSettings, evaluate
from lmeasure.recording import Program
from lmeasure.trajectory import Trajectory

FloatArray = NDArray[np.float64]
EXACT = StatedErrors()
LINE = {"name": "line", "kind": "linear", "start_mm": (0.0, 0.0, 0.0), "end_mm": (300.0, 400.0, 0.0), "speed_mm_s": 250.0}
CIRCLE = {
    "name": "circle", "kind": "circular", "centre_mm": (10.0, 20.0, 30.0), "normal": (0.0, 0.0, 2.0), "radius_mm": 100.0,
    "start_mm": (110.0, 20.0, 35.0),
}  # fmt: skip
SQUARE = {
    "name": "square",
    "kind": "rectangular",
    "corners_mm": ((0.0, 0.0, 0.0), (200.0, 0.0, 0.0), (200.0, 200.0, 0.0), (0.0, 200.0, 0.0)),
}


def program_of(path: dict[str, Any], windows: list[tuple[float, float]], **more: Any) -> Program:
    """A program of one path."""
    return Program.model_validate({"schema": "lmeasure.program/1", "path": [path | {"windows_s": windows}]} | more)


def figures(trajectory: Trajectory, program: Program, **settings: Any) -> dict[tuple[str, str | None], float]:
    """Values by name and part of an exactly known trajectory."""
    found = evaluate(trajectory, program, EXACT, settings=CertificationSettings(trials=10, **settings))
    return {(c.name, c.part): c.value for c in found.characteristics}


def runs(way: FloatArray, cycles: list[FloatArray], rate_hz: float = 500.0) -> tuple[Trajectory, list[tuple[float, float]]]:
    """Cycles of positions (n, 3) each, one behind the other, and their windows."""
    n = len(way)
    time_s = np.arange(n * len(cycles)) / rate_hz
    return trajectory_of(time_s, np.concatenate(cycles)), [(time_s[i * n], time_s[(i + 1) * n - 1]) for i in range(len(cycles))]


def _once(way: FloatArray, place: FloatArray, path: dict[str, Any], rate_hz: float) -> tuple[Trajectory, Program]:
    """A path run once."""
    trajectory, windows = runs(way, [place], rate_hz)
    return trajectory, program_of(path, windows)
