"""Figures: what is certified of which part of a program, as functions of the parts' states."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from lmeasure.core import FloatArray
from lmeasure.iso9283.characteristic import CharacteristicKey
from lmeasure.text import Message, message

ANGLES = ("a", "b", "c")
AXES = ("x", "y", "z")


class Subject(NamedTuple):
    """Part of a program that a test, its states or an exclusion are of: a pose, a path, a corner of it by number."""

    kind: Literal["pose", "path", "corner", "weave", "distance", "compliance", "settling", "posing", "stabilisation"]
    name: str
    number: int = 0

    @property
    def said(self) -> Message:
        """In words: pose P1."""
        return message(f"subject.{self.kind}", name=self.name)


States = Mapping[Subject, Any]
Function = Callable[[States], FloatArray]


class OfInstants(NamedTuple):
    """Contribution of the samples' uncertain instants to a result: an independent standard uncertainty, and a bias of known sign."""

    u: float
    bias: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A characteristic yet without its value: function of the states of subjects. needs: what may exclude it; vector: the figure whose
    verdict a component takes; instants: what the instants of samples add to it, by its value, where its states do not hold that; between:
    how far it may be off by what lies between samples; extreme: it is the largest or the least of a path, which errors make larger."""

    key: CharacteristicKey
    clause: str
    unit: str
    cycles: int
    of: Function
    needs: tuple[Subject, ...]
    vector: str | None = None
    angles: str | None = None
    extension: bool = False
    instants: Callable[[float], OfInstants] | None = None
    between: float = 0.0
    extreme: bool = False


@dataclass(frozen=True, kw_only=True)
class Maker:
    """Common properties of the results of one part, see `Figure`; pose, path and part as in their keys."""

    cycles: int
    needs: tuple[Subject, ...]
    pose: str | None = None
    path: str | None = None
    part: str | None = None
    angles: str | None = None

    def one(self, name: str, clause: str, unit: str, of: Function, **more: Any) -> Figure:
        """A figure."""
        key = CharacteristicKey(name, self.pose, self.path, self.part)
        return Figure(key=key, clause=clause, unit=unit, cycles=self.cycles, of=of, needs=self.needs, **more)

    def components(self, stem: str, clause: str, of: Function, axes: Sequence[str] = AXES, **more: Any) -> list[Figure]:
        """Figures of the components of (..., 3): of lengths along axes, or of angles."""
        given = {"unit": "deg", "angles": self.angles} if axes is ANGLES else {"unit": "mm"}
        return [self.one(f"{stem}_{a}", clause, of=component(of, i), **given, **more) for i, a in enumerate(axes)]

    def rotation(self, name: str, clause: str, of: Function) -> Figure:
        """A figure of the rotation as a whole, which the standard does not have."""
        return self.one(name, clause, "deg", of, extension=True)


def component(of: Function, *index: int) -> Function:
    """One component of a figure that has several."""
    at: Any = (..., *index)
    return lambda states: of(states)[at]
