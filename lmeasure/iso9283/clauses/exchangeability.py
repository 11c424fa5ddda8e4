"""Exchangeability (clause 7.7): robots of one type that are sent to one pose."""

from collections.abc import Iterator
from dataclasses import dataclass

from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity
from lmeasure.iso9283.clauses.pose import split
from lmeasure.iso9283.figure import Figure, Maker, Subject
from lmeasure.iso9283.formulas import pose as iso


@dataclass(frozen=True, kw_only=True)
class ExchangeabilityTest(IsoTest):
    """E of a pose whose cycles are of robots (n,)."""

    robots: tuple[str, ...]

    def figures(self) -> list[Figure]:
        key, of = self.subject, self.robots
        make = Maker(cycles=len(of), needs=(key,), pose=key.name)
        return [make.one("E", "7.7", "mm", lambda s: iso.exchangeability(split(s[key].position, of)))]


def tests(attained: Attainment) -> Iterator[ExchangeabilityTest]:
    """Of every pose that has windows and cycles of several robots."""
    for pose in attained.program.pose:
        if pose.name in attained.poses and len(set(pose.units)) > 1:
            yield ExchangeabilityTest(subject=Subject("pose", pose.name), robots=pose.units)


CLAUSE = Clause(tests=tests, quantities=(Quantity(symbol="E", label="exchangeability", summary={"E": 170}),))
