"""Part of a position's U95 from assumed typical sizes, and the statements that would help most.

An error of the poses is F z with independent z of unit variance. The part of a group of variables is its own columns (or its share of the
mixed columns, if a run determined some of z). A group whose size becomes r times the assumed one leaves F - (1 - r) F_group.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.kernels import RADIUS_95
from lmeasure.rig import TYPICAL_SIZES
from lmeasure.text import Message, message

DEGREE = 5
MOST = 5  # Statements that are listed
LEAST = 0.99  # A statement is listed that leaves less than this share of U95


def radii_95(covariances: FloatArray) -> FloatArray:
    """(n,) radii that hold 95 % of Gaussians with covariances (n, 3, 3), by the kernels' polynomial; 0 where there is none."""
    eigenvalues = np.maximum(np.linalg.eigvalsh(covariances), 0.0)
    e1 = eigenvalues.sum(axis=1)
    x, y, z = (eigenvalues / np.where(e1 > 0.0, e1, 1.0)[:, None]).T
    coefficients = np.array([row + (0.0,) * (DEGREE + 1 - len(row)) for row in RADIUS_95])
    return np.asarray(np.sqrt(e1) * np.polynomial.polynomial.polyval2d(3.0 * (x * y + y * z + z * x), 27.0 * x * y * z, coefficients))


def positions_95(factors: FloatArray) -> FloatArray:
    """(n,) radii that hold 95 % of position errors factors (n, 6, K); NaN where there is no pose."""
    out = np.full(len(factors), np.nan)
    known = np.isfinite(factors).all(axis=(1, 2))
    places = factors[known, 3:]
    out[known] = radii_95(places @ np.swapaxes(places, 1, 2))
    return out


@dataclass(frozen=True)
class Statement:
    """A statement that would make U95 smaller. key: of the typical size that it replaces; u95_mm: the largest U95 with it [mm]."""

    key: str
    u95_mm: float

    def said(self, u95_mm: float) -> Message:
        """Return the sentence for a person; u95_mm: U95 without the statement."""
        size = TYPICAL_SIZES[self.key]
        return message("assumed.statement", what=size.what, size=size.stated_size, key=self.key, u95=u95_mm, then=self.u95_mm)


@dataclass(frozen=True)
class Assumed:
    """Part of assumed sizes in the position's uncertainty, the largest over some poses [mm]: U95, U95 of the assumed sizes alone, U95
    after each statement, and after all of them. exact: whether everything that is not stated is exact by statement."""

    u95_mm: float = 0.0
    part_mm: float = 0.0
    every: tuple[Statement, ...] = ()
    after_all_mm: float = 0.0
    exact: bool = False
    where: Message | None = None
    """The least and the largest part over the poses, and where that is."""

    def joined(self, other: "Assumed") -> "Assumed":
        """Return both, of two pieces of a run."""
        left, right = ({one.key: one.u95_mm for one in each.every} for each in (self, other))
        # a statement leaves U95 as it is in a piece that does not assume its size
        every = (Statement(key, max(left.get(key, self.u95_mm), right.get(key, other.u95_mm))) for key in left | right)
        u95_mm, part_mm = max(self.u95_mm, other.u95_mm), max(self.part_mm, other.part_mm)
        return Assumed(u95_mm, part_mm, tuple(every), max(self.after_all_mm, other.after_all_mm), self.exact or other.exact)

    @property
    def statements(self) -> tuple[Statement, ...]:
        """The statements that would help most, the best first, at most `MOST`."""
        helpful = (one for one in self.every if one.u95_mm < LEAST * self.u95_mm)
        return tuple(sorted(helpful, key=lambda one: one.u95_mm)[:MOST])

    @property
    def lines(self) -> list[Message]:
        """The lines for a person: how much is assumed, then the statements."""
        if not self.part_mm:
            return [message("assumed.exact")] if self.exact else []
        last = message("assumed.all", u95=self.u95_mm, then=self.after_all_mm)
        listed = [*(one.said(self.u95_mm) for one in self.statements), last] if self.statements else []
        where = [] if self.where is None else [self.where]
        return [message("assumed.part", u95=self.u95_mm, part=self.part_mm), *where, *listed]

    def figures(self) -> dict[str, float]:
        """Return the numbers by name."""
        if not self.part_mm:
            return {}
        found = {"largest_u95_position_mm": self.u95_mm, "largest_u95_assumed_mm": self.part_mm, "u95_if_all_stated_mm": self.after_all_mm}
        return found | {f"u95_if_stated_{one.key}_mm": one.u95_mm for one in self.statements}


NOTHING = Assumed()  # Of poses whose uncertainty has nothing assumed


def place_of(poses: FloatArray, parts_mm: FloatArray) -> Message | None:
    """Return between which sizes assumed parts of U95 (n,) lie at poses (n, 7), and where the largest is."""
    if np.isnan(parts_mm).all():
        return None
    x, y, z = poses[int(np.nanargmax(parts_mm)), :3]
    return message("assumed.where", least=float(np.nanmin(parts_mm)), most=float(np.nanmax(parts_mm)), x=float(x), y=float(y), z=float(z))


def assumed_of(own: FloatArray, factors: FloatArray, groups: dict[str, FloatArray]) -> Assumed:
    """Return the effect of assumed sizes on poses with random errors own (n, 6, m) and shared ones factors (n, 6, K); groups: factors
    (n, 6, K) of the variables of each typical size, by its key."""
    known = np.isfinite(own).all(axis=(1, 2)) & np.isfinite(factors).all(axis=(1, 2))
    if not known.any():
        return NOTHING
    own, factors = own[known], factors[known]

    def largest(shared: FloatArray) -> float:
        return float(positions_95(np.concatenate([own, shared], axis=2)).max())

    parts = {key: group[known] for key, group in groups.items()}
    gone = {key: (1.0 - TYPICAL_SIZES[key].stated_share) * part for key, part in parts.items()}
    left = tuple(Statement(key, largest(factors - part)) for key, part in gone.items())
    every, all_gone = (sum(each.values(), start=np.zeros_like(factors)) for each in (parts, gone))
    return Assumed(largest(factors), float(positions_95(every).max()), left, largest(factors - all_gone))
