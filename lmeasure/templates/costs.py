"""What an error of a dimension costs: how far off the gripper is measured when the rig file is wrong by a millimetre or a degree."""

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, se3
from lmeasure.rig import GUIDE, PLACE, Rig
from lmeasure.sensors import CableLength, cable_lengths, shared_errors, twists
from lmeasure.templates.shapes import HALF_MM, TILT_RAD

NODES = 3


@dataclass(frozen=True)
class Cost:
    """The largest error of the tool's position [mm] in a box by one unit of an error of the rig file, in the worst direction where there
    are several. unit: 1 mm, 1 deg, or what is usual."""

    unit: str
    mm: float


def box_poses(half_mm: float = HALF_MM, tilt_rad: float = TILT_RAD) -> FloatArray:
    """(n, 7) poses of a box about the base frame's origin: its corners, middles and centre, with every tilt."""
    places = np.array(list(itertools.product(np.linspace(-half_mm, half_mm, NODES), repeat=3)))
    turns = [np.zeros(3), *(sign * tilt_rad * np.eye(3)[i] for i in range(3) for sign in (-1.0, 1.0))]
    return np.concatenate([se3.pose(places, Rotation.from_rotvec(np.tile(turn, (len(places), 1)))) for turn in turns])


def position_errors(rig: Rig, zeroed_at: FloatArray, poses: FloatArray, names: tuple[str, ...]) -> FloatArray:
    """(n, 3, q) errors of the tool's position [mm] at poses (n, 7) by one unit of an error of each parameter names (q,) of the rig, whose
    counters were zeroed at a pose (7,); first order. A parameter that several cables have errs once for all."""
    channels: list[CableLength] = cable_lengths(rig, zeroed_at)
    return np.asarray(shared_errors(channels, poses, twists(channels, poses), names=names, root=np.eye(len(names)))[:, 3:])


def costs(rig: Rig, zeroed_at: FloatArray | None = None, poses: FloatArray | None = None) -> dict[str, Cost]:
    """What an error costs, by `B1.position_mm`, `B1.guide`, `B1.pulley_radius_mm`, the keys of its drum, and `P1`."""
    start = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]) if zeroed_at is None else zeroed_at
    box = box_poses() if poses is None else poses

    def worst(*names: str) -> float:
        # of all directions of an error of length 1, the one that moves the tool most, where the cables can run at all
        errors = position_errors(rig, start, box, names)
        return float(np.linalg.norm(errors[np.isfinite(errors).all(axis=(1, 2))], ord=2, axis=(1, 2)).max(initial=0.0))

    out: dict[str, Cost] = {}
    for name in dict.fromkeys(c.from_point for c in rig.cable):
        out[f"{name}.position_mm"] = Cost("1 mm", worst(*(f"{name}.{key}" for key in PLACE)))
        out[f"{name}.guide"] = Cost("1 deg", max(worst(f"{name}.{key}") for key in GUIDE))
        out[f"{name}.count_length_mm"] = Cost("0.1 %", 1e-3 * worst(f"{name}.scale"))
        out[f"{name}.groove_pitch_mm"] = Cost("0.1 mm", 0.1 * worst(f"{name}.groove_pitch_mm"))
        for key in ("pulley_radius_mm", "tangent_length_mm", "axial_offset_mm"):
            out[f"{name}.{key}"] = Cost("1 mm", worst(f"{name}.{key}"))
    for point in dict.fromkeys(c.to_point for c in rig.cable):
        out[point] = Cost("1 mm", worst(*(f"tool.{point}.{axis}_mm" for axis in "xyz")))
    return out
