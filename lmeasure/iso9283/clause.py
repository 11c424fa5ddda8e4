"""Test of ISO 9283 for the evaluation: a subject of the program with everything that belongs to its test.

A test module contains one class, a function from the attained parts to its tests, and its `Clause`, the prior facts of its quantities. Most
figures are functions of the states of parts, whose errors are drawn for all tests together (`uncertainty.propagate`); others are read from
the motion itself (`readings`) and bring their own uncertainty. Nothing depends on the order of tests.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from lmeasure.core import IntArray, check_kind
from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.characteristic import Characteristic, CharacteristicKey
from lmeasure.iso9283.figure import Figure, Subject
from lmeasure.iso9283.motion_readings import Motion
from lmeasure.iso9283.uncertainty import Part
from lmeasure.recording import Windows
from lmeasure.text import Message
from lmeasure.trajectory import PoseErrors

SampleErrors = Callable[[IntArray], PoseErrors]
"""Errors of the certified point at samples (n,), by one law."""


class Read(NamedTuple):
    """Characteristics read from a motion, and the reasons for those that cannot be."""

    characteristics: Sequence[Characteristic] = ()
    findings: Sequence[Message] = ()


@dataclass(frozen=True, kw_only=True)
class IsoTest:
    """A test; a default here means that it has no such part.

    subject: its part of the program; tests of one subject are listed together. windows: times of measurement, for a test that may be
    excluded by angle_deg, the worst pressure angle there, or by the errors of `excludable`. needs: conditions that may exclude the figures
    that it reads. findings: the form of its figures.
    """

    subject: Subject
    windows: Windows = ()
    angle_deg: float = math.nan
    needs: tuple[Subject, ...] = ()
    findings: tuple[Message, ...] = ()

    def samples(self) -> IntArray:
        """(n,) samples of the trajectory at whose errors it looks."""
        return np.empty(0, dtype=np.int64)

    def parts(self, errors: SampleErrors) -> dict[Subject, Part]:
        """Return the parts that its figures are computed from, each with the covariance of its errors."""
        return {}

    def excludable(self, errors: SampleErrors) -> PoseErrors | None:
        """Return errors that are compared with the zone's radius."""
        part = self.parts(errors).get(self.subject)
        return None if part is None else part.errors

    def figures(self) -> list[Figure]:
        """Functions of states, of its own parts or of others'."""
        return []

    def read(self, motion: Motion, known: Mapping[CharacteristicKey, float]) -> Read:
        """Figures read from the motion; known: the values of those that are not."""
        return Read()


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Properties that all characteristics of one symbol share.

    Parameters
    ----------
    symbol
        Name of a characteristic (t_s), or the part of it before the index, which several characteristics share (AP of AP_p, AP_x, ...).
    label
        Name in English.
    labels
        Names in other languages, by language; those of this program are in its catalogues.
    summary
        Characteristics that the first page of a certificate lists, with their places in that list: those with small numbers come first.
    signed
        Characteristics, besides components of vectors, that may be negative, and zero without being bad.
    trend
        Characteristic that is drawn over several certificates; its largest value is among the figures of `certify --json`.
    between
        What a name such as P2-P4 is of: "distance" or "move"; empty for characteristics of one pose or path.
    """

    symbol: str
    label: str
    labels: Mapping[str, str] = field(default_factory=dict)
    summary: Mapping[str, int] = field(default_factory=dict)
    signed: tuple[str, ...] = ()
    trend: str = ""
    between: Literal["", "distance", "move"] = ""


@dataclass(frozen=True, kw_only=True)
class Clause:
    """A test as a whole: its search in the attained parts, and its quantities."""

    tests: Callable[[Attainment], Iterable[IsoTest]]
    quantities: tuple[Quantity, ...]

    def __post_init__(self) -> None:
        check_kind((), self.tests)
