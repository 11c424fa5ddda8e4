"""The robot's program: commanded poses and paths, as program.toml writes them."""

import itertools
import math
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from lmeasure import files
from lmeasure.errors import FileFormatError

FloatArray = NDArray[np.float64]
Vector = tuple[float, float, float]
Windows = tuple[tuple[float, float], ...]

NEEDS = {
    "linear": ("start_mm", "end_mm"),
    "circular": ("centre_mm", "normal", "radius_mm", "start_mm"),
    "rectangular": ("corners_mm",),
    "points": ("points_mm",),
}


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True)


class CommandedPose(_Strict):
    """A pose the robot is told to take; windows_s are its dwells, one per cycle."""

    name: Annotated[str, Field(min_length=1)]
    position_mm: Vector
    quaternion_xyzw: tuple[float, float, float, float]
    windows_s: Windows = ()

    @model_validator(mode="after")
    def _unit(self) -> Self:
        if abs(math.hypot(*self.quaternion_xyzw) - 1.0) > 1e-6:
            raise ValueError(f"quaternion_xyzw of pose {self.name} is not of length 1")
        return self


class CommandedPath(_Strict):
    """A path of the tool origin [mm, base frame] at a commanded speed."""

    name: Annotated[str, Field(min_length=1)]
    kind: Literal["linear", "circular", "rectangular", "points"]
    start_mm: Vector | None = None
    end_mm: Vector | None = None
    centre_mm: Vector | None = None
    normal: Vector | None = None
    radius_mm: Annotated[float, Field(gt=0)] | None = None
    corners_mm: Annotated[tuple[Vector, ...], Field(min_length=3)] | None = None
    points_mm: Annotated[tuple[Vector, ...], Field(min_length=2)] | None = None
    speed_mm_s: Annotated[float, Field(gt=0)] | None = None
    windows_s: Windows = ()

    @model_validator(mode="after")
    def _complete(self) -> Self:
        for key in NEEDS[self.kind]:
            if getattr(self, key) is None:
                raise ValueError(f"path {self.name}: kind {self.kind!r} needs {key}")
        if self.normal is not None and math.hypot(*self.normal) == 0.0:
            raise ValueError(f"path {self.name}: normal has no length")
        return self

    def points(self, step_mm: float) -> FloatArray:
        """(n, 3) points along the path [mm], at most step_mm apart; a closed kind comes back to its start."""
        if self.kind == "circular":
            return self._circle(step_mm)
        if self.kind == "linear":
            corners = np.array([self.start_mm, self.end_mm], dtype=np.float64)
        elif self.kind == "rectangular":
            assert self.corners_mm is not None
            corners = np.array([*self.corners_mm, self.corners_mm[0]], dtype=np.float64)
        else:
            corners = np.array(self.points_mm, dtype=np.float64)
        parts = [corners[:1]]
        for a, b in itertools.pairwise(corners):
            n = max(1, math.ceil(float(np.linalg.norm(b - a)) / step_mm))
            parts.append(a + (np.arange(1, n + 1) / n)[:, None] * (b - a))
        return np.concatenate(parts)

    def _circle(self, step_mm: float) -> FloatArray:
        centre, normal = np.array(self.centre_mm, dtype=np.float64), np.array(self.normal, dtype=np.float64)
        assert self.radius_mm is not None
        normal /= np.linalg.norm(normal)
        out = np.array(self.start_mm, dtype=np.float64) - centre
        out -= (out @ normal) * normal
        out *= self.radius_mm / np.linalg.norm(out)
        turn = np.linspace(0, 2 * math.pi, max(8, math.ceil(2 * math.pi * self.radius_mm / step_mm)) + 1)
        return np.asarray(centre + np.cos(turn)[:, None] * out + np.sin(turn)[:, None] * np.cross(normal, out))


class Program(_Strict):
    """Poses and paths of a program.toml, in file order."""

    schema_: Annotated[Literal["lmeasure.program/1"], Field(alias="schema")]
    angles: str | None = None
    """Convention of component-wise angles; see `lmeasure.conventions`."""
    pose: tuple[CommandedPose, ...] = ()
    path: tuple[CommandedPath, ...] = ()


def read_program(path: Path) -> Program:
    """Read a program.toml; FileFormatError names the file and the key."""
    try:
        return Program.model_validate(files.read_toml(path))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise FileFormatError(f"{path}: {'.'.join(str(s) for s in first['loc'])}: {first['msg']}") from None
