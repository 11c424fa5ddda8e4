"""Rows of lanes: what the stages of the zone's lane kernel share, a buffer of rows that are LANES long and the way to them."""

from lmeasure.core import FloatArray
from lmeasure.kernels.decorators import inline
from lmeasure.kernels.vector import Vec3
from lmeasure.kernels.zone import WORST_START

LANES = 32

# Rows, LANES long each. The compiler vectorises a loop only where it can prove that rows do not overlap: all offsets within one buffer are
# constants, and values that depend on the cable have a part of their own.
# of a cable: direction and straight part of its free span, then by its unit rate the tool's turn and move and the velocity of a point
SPAN, STRAIGHT, TURN, MOVE, VELOCITY, CABLE_ROWS = 0, 3, 4, 7, 10, 13
# of the place: the tool origin, a covariance (xx, yy, zz, xy, xz, yz), worst figures so far, least indicator of a sound inverse, total of
# the radii, which keeps non-finite values
PLACE, COVARIANCE, WORST = 0, 3, 9
SOUND, TOTAL, PLACE_ROWS = WORST + len(WORST_START), WORST + len(WORST_START) + 1, WORST + len(WORST_START) + 2


@inline
def at(B: FloatArray, row: int, lane: int) -> Vec3:
    return B[row * LANES + lane], B[(row + 1) * LANES + lane], B[(row + 2) * LANES + lane]


@inline
def put(B: FloatArray, row: int, lane: int, a: Vec3) -> None:
    B[row * LANES + lane], B[(row + 1) * LANES + lane], B[(row + 2) * LANES + lane] = a


@inline
def least(B: FloatArray, row: int, lane: int, value: float) -> None:
    kept = B[row * LANES + lane]
    B[row * LANES + lane] = value if value < kept else kept


@inline
def most(B: FloatArray, row: int, lane: int, value: float) -> None:
    kept = B[row * LANES + lane]
    B[row * LANES + lane] = value if value > kept else kept
