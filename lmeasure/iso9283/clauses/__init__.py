"""The tests of ISO 9283:1998: their windows, their figures with their uncertainties, their exclusions and notes.

Each module contains all about its own characteristics; a new test is its file and a word in `CLAUSES`. Other packages add theirs by the
entry point `lmeasure.characteristics` (docs/extending.md), which is read only for a program that names them.
"""

from collections.abc import Iterable

from lmeasure.core import CertificationError, plug_in, plug_in_names, plug_ins
from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity
from lmeasure.iso9283.clauses import compliance, corners, cycle_groups, distance, path, pose, settling, stabilisation, velocity, weaving
from lmeasure.text import message

CLAUSES: tuple[Clause, ...] = (
    pose.CLAUSE,
    cycle_groups.CLAUSE,
    distance.CLAUSE,
    compliance.CLAUSE,
    path.CLAUSE,
    velocity.CLAUSE,
    corners.CLAUSE,
    weaving.CLAUSE,
    settling.CLAUSE,
    stabilisation.CLAUSE,
)
"""The table of the tests; certificates list figures in this order, those of one subject together."""
GROUP = "lmeasure.characteristics"


def clauses_of(names: Iterable[str]) -> tuple[Clause, ...]:
    """Return the tests of the standard, and those of other packages that a program names.

    Raises
    ------
    CertificationError
        If no installed package has one of the names.
    PlugInError
        If a package has it and cannot be used.
    """
    added = []
    for name in names:
        found = plug_in(GROUP, name, Clause)
        if found is None:
            known = ", ".join(plug_in_names(GROUP)) or "none"
            raise CertificationError(message("error.characteristics_no_installed_package", name=name, known=known))
        added.append(found)
    return (*CLAUSES, *added)


def tests_of(clauses: Iterable[Clause], attained: Attainment) -> list[IsoTest]:
    """Return all tests that a trajectory holds of its program."""
    found = [test for clause in clauses for test in clause.tests(attained)]
    order = {subject: i for i, subject in enumerate(dict.fromkeys(test.subject for test in found))}
    return sorted(found, key=lambda test: order[test.subject])


def signed_names(clauses: Iterable[Clause]) -> tuple[str, ...]:
    """Return the characteristics that may be negative, and zero without being bad, besides components of vectors."""
    return tuple(name for clause in clauses for quantity in clause.quantities for name in quantity.signed)


def trend_names() -> tuple[str, ...]:
    """Return the characteristics of the standard that are followed over several certificates, as the first page of one lists them."""
    followed = [(q.summary[q.trend], q.trend) for clause in CLAUSES for q in clause.quantities if q.trend]
    return tuple(name for _, name in sorted(followed))


def quantity_of(name: str) -> Quantity | None:
    """Return the description of a characteristic such as AP_p, of other packages too; None where no installed package knows it."""
    return _quantity(CLAUSES, name) or _quantity(plug_ins(GROUP, Clause)[0].values(), name)


def _quantity(clauses: Iterable[Clause], name: str) -> Quantity | None:
    known = {quantity.symbol: quantity for clause in clauses for quantity in clause.quantities}
    return known.get(name) or known.get(name.partition("_")[0])
