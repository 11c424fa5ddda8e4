"""What a certificate says, held against what its inputs give again."""

import math
import re
from collections.abc import Mapping
from typing import Any

from lmeasure.certification.bundle import CERTIFICATE, Difference
from lmeasure.certification.canonical import canonical
from lmeasure.certification.certificate import identification
from lmeasure.certification.characteristic import key_of
from lmeasure.certification.environment import LIBRARIES
from lmeasure.certification.method import METHOD, method_of
from lmeasure.certification.printed import with_u95
from lmeasure.findings import in_todays_words

RELATIVE = 1e-6
"""Another processor or other versions may change the last digits: up to this part of the figure or of its U95, whichever is larger."""
ROUNDED, RELATIVE_ROUNDED = 5, 1e-5
"""Up to this method errors were drawn along what had been rounded off a covariance too, which is another number on each processor: figures
of means of dwells that vibrate differ by up to so much."""
SMALLEST = 1e-9
"""What is smaller than so much [mm, deg, s] is the same as nothing: means and frames."""
INDEPENDENT = ("schema", "kind", "details", "measurement", "inputs", "program")
"""Tables of a certificate that do not depend on how figures are computed."""
_NUMBER = re.compile(r"([-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)")
_VERSION = re.compile(r"[\w.+()-]+(?: [\w.+()-]+)?", re.ASCII)
SOURCES = "lmeasure sources"
_ENVIRONMENT = ("lmeasure", SOURCES, "python", *LIBRARIES, "system", "processor")


def label(figure: Mapping[str, Any]) -> str:
    """A characteristic by name, for a person: AP_p of P1."""
    return str(key_of(figure))


def allowed_of(method: int) -> float:
    """Up to what part figures of a method may differ on another machine."""
    return RELATIVE if method > ROUNDED else RELATIVE_ROUNDED


def compare(stated: dict[str, Any], again: dict[str, Any], *, exact: bool) -> tuple[list[Difference], float]:
    """Where a certificate is not the one its inputs give by the same method, figure by figure, and the largest relative difference of one.

    exact: every digit counts; else numbers may differ by `RELATIVE`, figures of early methods by `RELATIVE_ROUNDED`.
    """
    out: list[Difference] = []
    allowed = 0.0 if exact else allowed_of(method_of(stated))
    largest = 0.0
    old, new = (_keyed(c["characteristics"]) for c in (stated, again))
    out += [Difference(name, "is certified, but the inputs do not give it") for name in old if name not in new]
    out += [Difference(name, "is not certified, but the inputs give it") for name in new if name not in old]
    for name, figure in old.items():
        other = new.get(name, figure)
        for key in sorted({*figure, *other}):
            a, b = figure.get(key), other.get(key)
            part = _relative(a, b, max(abs(figure["value"]), abs(figure["u95"] or 0.0))) if canonical(a) != canonical(b) else 0.0
            largest = max(largest, part)
            if part > allowed:
                out.append(Difference(name, f"{key} is certified as {_shown(a)}, computed again {_shown(b)}"))
    # tables that an earlier version did not write; and which of the texts, compared where they stand, it had codes for
    later = set() if exact else {*again} - {*stated} | {"findings"}
    out += _tables(stated, again, {*stated, *again} - {"characteristics", "figures_sha256", "id"} - later, exact=exact)
    out += has_its_id(stated)
    if exact and not out and stated["figures_sha256"] != again["figures_sha256"]:
        out.append(Difference(CERTIFICATE, "figures_sha256 is not that of its figures"))
    return out, largest if math.isfinite(largest) else 0.0


def beside(stated: dict[str, Any], again: dict[str, Any]) -> tuple[list[Difference], tuple[str, ...]]:
    """Of a certificate by another method: where what does not depend on the method is not what the inputs give, and its figures with those
    of today, a line each."""
    out = _tables(stated, again, {key for key in INDEPENDENT if key in stated}, exact=True) + has_its_id(stated)
    old, new = (_keyed(c["characteristics"]) for c in (stated, again))
    lines = [f"{name}: sealed {_figure(old.get(name))}, today {_figure(new.get(name))}" for name in {**old, **new}]
    return out, (f"figures by method {method_of(stated)}, as sealed, beside those by method {METHOD}:", *lines)


def has_its_id(stated: dict[str, Any]) -> list[Difference]:
    """Whether the id of a certificate is that of its content."""
    own = identification(stated)
    return [] if stated["id"] == own else [Difference(CERTIFICATE, f"id is {stated['id']}, but its content gives {own}")]


def of_environment(stated: Mapping[str, Any], here: Mapping[str, str]) -> list[Difference]:
    """What stands in a certificate as its environment and is none: where it names the sources of this program, the very keys are known."""
    out = [
        Difference(CERTIFICATE, f"environment: {_shown(key)} is {_shown(value)}: no version")
        for key, value in stated.items()
        if not isinstance(value, str) or len(value) > 80 or not _VERSION.fullmatch(value)
    ]
    if stated.get(SOURCES) == here[SOURCES]:
        out += [Difference(CERTIFICATE, f"environment: {_shown(key)} is no part of it") for key in stated if key not in _ENVIRONMENT]
        out += [Difference(CERTIFICATE, f"environment: {key} is missing") for key in _ENVIRONMENT if key not in stated]
    return out


def _tables(stated: dict[str, Any], again: dict[str, Any], keys: set[str], *, exact: bool) -> list[Difference]:
    out = []
    for key in sorted(keys):
        a, b = stated.get(key), again.get(key)
        if canonical(a) != canonical(b) and (exact or not _alike(a, b)):
            out.append(Difference(CERTIFICATE, f"{key} is {_shown(a)}, computed again {_shown(b)}"))
    return out


def _alike(a: Any, b: Any) -> bool:
    """Whether two tables say the same but for the last digits of their numbers, those in texts included."""
    if isinstance(a, dict) and isinstance(b, dict):
        return set(a) == set(b) and all(_alike(a[k], b[k]) for k in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_alike, a, b))
    if isinstance(a, str) and isinstance(b, str):
        one, other = _NUMBER.split(in_todays_words(a)), _NUMBER.split(in_todays_words(b))
        return len(one) == len(other) and all(
            x == y or (i % 2 == 1 and _printed_alike(x, y)) for i, (x, y) in enumerate(zip(one, other, strict=True))
        )
    if all(isinstance(x, int | float) and not isinstance(x, bool) for x in (a, b)):
        return math.isclose(a, b, rel_tol=RELATIVE, abs_tol=SMALLEST)
    return bool(a == b)


def _printed_alike(a: str, b: str) -> bool:
    """Whether two printed numbers are one but for their last digit."""
    last = [10.0 ** -len(x.lower().split("e")[0].partition(".")[2]) for x in (a, b)]
    whole = "." not in a and "." not in b and "e" not in (a + b).lower()
    return not whole and abs(float(a) - float(b)) <= max(RELATIVE * abs(float(a)), 1.001 * max(last))


def _relative(a: Any, b: Any, size: float) -> float:
    """Difference of two entries as a part of the figure's size; infinite where they are no numbers."""
    if isinstance(a, dict) and isinstance(b, dict) and set(a) == set(b):
        return max((_relative(a[k], b[k], size) for k in a), default=0.0)
    if all(isinstance(x, int | float) and not isinstance(x, bool) for x in (a, b)):
        return abs(a - b) / max(size, abs(a)) if a != b else 0.0
    same = _alike(a, b) if isinstance(a, str) else a == b
    return 0.0 if same else math.inf


def _figure(figure: Mapping[str, Any] | None) -> str:
    if figure is None:
        return "none"
    if figure["u95"] is None:
        return f"{figure['value']:.6g} {figure['unit']}, uncertainty not stated"
    value, u95 = with_u95(float(figure["value"]), float(figure["u95"]))
    return f"{value} ± {u95} {figure['unit']}, {'capable' if figure['capable'] else 'not capable'}"


def _shown(value: Any) -> str:
    text = repr(value) if not isinstance(value, str) else value
    return text if len(text) <= 80 else text[:80] + "..."


def _keyed(figures: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    out: dict[str, dict[str, Any]] = {}
    for figure in figures:
        name, number = label(figure), 2
        while name in out:
            name, number = f"{label(figure)} ({number})", number + 1
        out[name] = figure
    return out
