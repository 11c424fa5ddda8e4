"""Positions that a program declares: which of several with one name a place means, and what became known of them."""

from collections.abc import Iterator
from dataclasses import dataclass, field

from lmeasure.robot_programs.program import Span
from lmeasure.text import message

Region = tuple[tuple[int, int, int], ...]
EVERYWHERE: Region = ()


@dataclass
class Point:
    """A declared position: its name as written, source, type and place; region, (source, start, stop) of the texts that know it, or
    everywhere; used: the frames (base, tool) that it is moved to in; first: the first motion; changed: why it is no constant."""

    name: str
    source: int
    kind: str
    span: Span
    region: Region
    used: set[tuple[str, str]] = field(default_factory=set)
    first: tuple[int, int] | None = None
    changed: str = ""

    def use(self, frames: set[tuple[str, str]], motion: tuple[int, int]) -> None:
        """Moved to by the motion at that source and place."""
        self.used |= frames
        self.first = self.first or motion


class Points:
    """Declared positions by their names, in whatever case these are written."""

    def __init__(self) -> None:
        self._all: dict[str, list[Point]] = {}

    def add(self, point: Point) -> None:
        """Two of one name that are known in the same region cannot be distinguished: both become no constants."""
        same = self._all.setdefault(point.name.upper(), [])
        for other in same:
            if other.region == point.region:
                other.changed = point.changed = message("robot_programs.declared_more_than_once_2")
        same.append(point)

    def at(self, name: str, source: int, place: int) -> Point | None:
        """Which of that name a place means: that known in the smallest region around it."""
        around = [(_size(p, source, place), p) for p in self._all.get(name.upper(), [])]
        known = [(size, p) for size, p in around if size is not None]
        return min(known, key=lambda one: one[0])[1] if known else None

    def __iter__(self) -> Iterator[Point]:
        return (p for same in self._all.values() for p in same)


def _size(point: Point, source: int, place: int) -> float | None:
    """How large the region is; None where the place is not in it."""
    if point.region == EVERYWHERE:
        return float("inf")
    there = any(k == source and start <= place <= stop for k, start, stop in point.region)
    return float(sum(stop - start for _, start, stop in point.region)) if there else None
