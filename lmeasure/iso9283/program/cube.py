"""The test cube of ISO 9283:1998, 6.8: its corners, its diagonal planes, and the poses and paths on them.

Corners are numbered C1 to C4 around the lower face and C5 to C8 above them, C1 towards +X and +Y, C2 towards +X and -Y.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmeasure.accuracy import extent, read_zone
from lmeasure.core import MAX_LENGTH_MM, CertificationError, FloatArray

PLANES = ("C1-C2-C7-C8", "C2-C3-C8-C5", "C3-C4-C5-C6", "C4-C1-C6-C7")
POSES = ("P1", "P2", "P3", "P4", "P5")
INSET = 0.1
"""Of a diagonal: how far from its ends P2 to P5 lie."""
_CORNERS = np.array([[1, 1, -1], [1, -1, -1], [-1, -1, -1], [-1, 1, -1], [1, 1, 1], [1, -1, 1], [-1, -1, 1], [-1, 1, 1]], dtype=np.float64)


@dataclass(frozen=True)
class Cube:
    """A cube with edges along the base axes: centre (3,) [mm], edge [mm], and the plane that holds the poses."""

    centre: FloatArray
    edge_mm: float
    plane: str = PLANES[0]

    def __post_init__(self) -> None:
        if self.plane not in PLANES:
            raise CertificationError(f"plane {self.plane!r}: the standard's planes are {', '.join(PLANES)}")
        # written so that NaN is refused
        if not (self.edge_mm > 0.0 and float(np.abs(self.centre).max()) + self.edge_mm <= MAX_LENGTH_MM):
            raise CertificationError(
                f"a cube of {self.edge_mm:g} mm: its edge must be more than 0 and it must lie within {MAX_LENGTH_MM:g} mm"
            )

    def corner(self, number: int) -> FloatArray:
        """Corner C1 to C8 (3,) [mm]."""
        return np.asarray(self.centre + 0.5 * self.edge_mm * _CORNERS[number - 1])

    def points(self) -> dict[str, FloatArray]:
        """P1 in the middle, P2 to P5 one after the other around the plane: at the diagonals' ends next to its first, fourth, third and
        second corner."""
        first, second, third, fourth = (self.corner(int(name[1])) for name in self.plane.split("-"))
        return {"P1": self.centre} | {
            name: (1.0 - INSET) * corner + INSET * (2.0 * self.centre - corner)
            for name, corner in zip(POSES[1:], (first, fourth, third, second), strict=True)
        }

    @property
    def normal(self) -> FloatArray:
        """Unit normal (3,) of the plane."""
        p = self.points()
        out = np.cross(p["P2"] - p["P1"], p["P3"] - p["P1"])
        return np.asarray(out / np.linalg.norm(out))


def largest_cube(low: Sequence[float], high: Sequence[float], plane: str = PLANES[0]) -> Cube:
    """The largest cube in the middle of a box, from its low and high corner (3,) [mm]."""
    first, last = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    if first.shape != (3,) or last.shape != (3,):
        raise CertificationError("a box needs three numbers, along x, y and z, for its low corner and its high one")
    if not (last - first > 0.0).all():
        raise CertificationError("the box has no volume: each axis must go from a smaller to a larger value")
    return Cube(0.5 * (first + last), float((last - first).min()), plane)


def cube_in_zone(path: Path, plane: str = PLANES[0]) -> Cube:
    """The largest cube of nodes in the accuracy zone of a file; CertificationError when none fits."""
    found = extent(read_zone(path)).cube
    if found is None:
        raise CertificationError(f"{path}: no cube fits into the zone")
    return Cube(found[0], found[1], plane)
