"""[[bearing]]: the horizontal circle of a total station that follows a reflector on the tool."""

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lmeasure.sensors import AngleSensor, SensorKind


class Bearing(AngleSensor):
    """The direction from the station to the reflector, from +X towards +Y of the robot's base frame."""

    kind: ClassVar[str] = "bearing"
    own: ClassVar[tuple[str, ...]] = ("position_mm",)
    motion: ClassVar[str] = "Turn the station's telescope counterclockwise, seen from above,"

    position_mm: tuple[float, float, float]
    """The station in the robot's base frame."""
    u_position_mm: float = 1.0
    """Standard uncertainty of each coordinate of it."""
    to: str
    """Name of the reflector's point in [tool]."""


def reading(own: NDArray[np.float64], place: NDArray[np.float64], turn: NDArray[np.float64]) -> float:
    """Return the angle [rad] at which the station sees the reflector at its place [mm]."""
    return math.atan2(place[1] - own[1], place[0] - own[0])


KIND = SensorKind(table=Bearing, reading=reading)
