"""Commands of a robot: one command after the other, each a way of the tool and a rest at its end."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from lmeasure.core import FloatArray, se3

Role = Literal["pose", "settling", "path", "posing", "compliance"]


def _no_force() -> FloatArray:
    return np.zeros(3)


@dataclass(frozen=True)
class Command:
    """Go from where the tool is through (k, 7) poses [mm, base frame] at a constant speed, and rest at the last.

    target: the pose, path, posing or loaded pose (role) of the program that is measured, empty on the way to one; cycle counts from 1. The
    tool origin runs straight between the poses; where only the orientation changes, it turns at rotation_rad_s. load_kg hangs from the
    tool, force_n (3,) [N, base frame] pulls at it.
    """

    poses: FloatArray
    speed_mm_s: float
    dwell_s: float = 0.0
    target: str = ""
    role: Role = "pose"
    cycle: int = 1
    rotation_rad_s: float = 1.0
    load_kg: float = 0.0
    force_n: FloatArray = field(default_factory=_no_force)

    def durations(self, start: FloatArray) -> FloatArray:
        """(k,) seconds of the ways to its poses, the first from `start` (7,): the slower of shift and turn."""
        rows = np.concatenate([start[None], self.poses])
        shift = np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1)
        turn = (se3.rotation(rows[:-1]).inv() * se3.rotation(rows[1:])).magnitude()
        return np.asarray(np.maximum(shift / self.speed_mm_s, turn / self.rotation_rad_s))
