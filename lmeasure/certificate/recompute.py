"""Comparison of a certificate with the results that its inputs give again."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from lmeasure.certificate.bundle import CERTIFICATE, Difference
from lmeasure.certificate.content import METHOD, identification
from lmeasure.certificate.signature import canonical, digest
from lmeasure.iso9283 import key_of
from lmeasure.text import composed, message, settled


def with_u95(value: float, u95: float) -> tuple[str, str]:
    """A value and its U95, which has two significant digits; the value ends at the same decimal."""
    if not u95 > 0:
        return f"{settled(value):.6g}", f"{u95:.2g}"
    decimals = 1 - math.floor(math.log10(u95))
    # 0.0996 rounds to 0.10, not to 0.100
    if round(u95, decimals) >= 10.0 ** (2 - decimals):
        decimals -= 1
    if decimals < 0:
        step = 10.0**-decimals
        return f"{round(value / step) * step:.0f}", f"{round(u95 / step) * step:.0f}"
    # + 0.0: what rounds to zero has no sign
    return f"{round(value, decimals) + 0.0:.{decimals}f}", f"{u95:.{decimals}f}"


RELATIVE = 1e-6
"""Two figures of one method agree when they differ by at most this part of their size, see `size_of`. Another kernel of BLAS or another
processor adds in another order: differences of about 1e-12, up to 1e-7 where a least-squares problem is badly conditioned."""
SMALLEST = 1e-9
"""Differences up to this [mm, deg, s, %] are last digits too: positions of 1000 mm are computed to about 1e-10 mm, and AP_p is a difference
of two."""
INDEPENDENT = ("schema", "kind", "details", "measurement", "inputs", "program")
"""Tables of a certificate that do not depend on how figures are computed."""
FIGURES = ("characteristics", "excluded", "base_from_program")
"""Tables whose digest is figures_sha256."""
UNCERTAINTIES = ("u95", "u", "u_random", "u_systematic", "bias", "u_drawn", "budget")
_NUMBER = re.compile(r"([-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?)")
_VERSION = re.compile(r"[\w.+()-]+(?: [\w.+()-]+)?", re.ASCII)
SOURCES = "lmeasure sources"


def label(figure: Mapping[str, Any]) -> str:
    """A characteristic by name, for a person: AP_p of P1."""
    return str(key_of(figure))


@dataclass(frozen=True)
class Compared:
    """The result of a comparison.

    differences: what is not as the inputs give it. largest: largest difference of a figure within the tolerance, as a part of its size.
    moved: whether anything differs in its last digits. skipped: what could not be compared, and why.
    """

    differences: tuple[Difference, ...]
    largest: float = 0.0
    moved: bool = False
    skipped: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Step:
    """A place where two tables differ: in last digits, by a part of the size; in the last printed digit of a text; or otherwise."""

    where: str
    kind: Literal["digits", "printed", "other"]
    part: float = 0.0


def size_of(key: str, figure: Mapping[str, Any]) -> float:
    """Return the size against which the difference of an entry of a figure is compared, from the figure as it is computed today.

    A relative difference means nothing near zero: AP_x of a good robot may be 1e-5 mm with a U95 of 0.01 mm, and its last digits change
    with the rounding of positions of 1000 mm. A change that is small against U95 changes no conclusion. So the value, and the limit that
    is a part of it, are compared with the larger of value and U95. Uncertainties are compared with U95 alone: else a large value
    would hide a forged U95. All others, such as coverage factors, are compared with themselves. Nothing stated by the certificate itself
    is used, so a forger cannot widen the tolerance.
    """
    u95 = abs(figure.get("u95") or 0.0)
    if key in UNCERTAINTIES:
        return u95
    return max(abs(figure["value"]), u95) if key in ("value", "limit_u95") else 0.0


def compare(stated: dict[str, Any], again: dict[str, Any], *, other_version: bool = False) -> Compared:
    """Compare a certificate with the one that its inputs give by the same method.

    Numbers may differ by `RELATIVE`. other_version: tables that another version of this program did not write are named, not compared.
    """
    out: list[Difference] = []
    old, new = (_keyed(c["characteristics"]) for c in (stated, again))
    out += [Difference(name, message("verification.not_from_inputs")) for name in old if name not in new]
    out += [Difference(name, message("verification.not_certified")) for name in new if name not in old]
    largest, moved, skipped = 0.0, False, []
    for name, figure in old.items():
        other = new.get(name, figure)
        for key in sorted({*figure, *other}):
            a, b = figure.get(key), other.get(key)
            steps = list(_steps(a, b, key, size_of(key, other)))
            if any(step.kind == "other" for step in steps):
                out.append(Difference(name, message("verification.other_result", key=key, stated=_shown(a), found=_shown(b))))
            else:
                largest = max([largest, *(step.part for step in steps)])
            moved |= bool(steps)
            skipped += [message("verification.last_digit", what=f"{name}: {step.where}") for step in steps if step.kind == "printed"]
    later = {*again} - {*stated} | {"findings"} if other_version else set()
    for key in sorted({*stated, *again} - {"characteristics", "figures_sha256", "id"}):
        a, b = stated.get(key), again.get(key)
        steps = list(_steps(a, b, key, 1.0 if key == "correlations" else 0.0))
        moved |= bool(steps)
        if steps and key in later:
            skipped.append(message("verification.other_form", what=f"{CERTIFICATE}: {key}"))
        elif any(step.kind == "other" for step in steps):
            out.append(Difference(CERTIFICATE, message("verification.other_value", key=key, stated=_shown(a), found=_shown(b))))
        skipped += [message("verification.last_digit", what=f"{CERTIFICATE}: {step.where}") for step in steps if step.kind == "printed"]
    out += has_its_id(stated)
    if not out and stated["figures_sha256"] != digest({key: stated.get(key) for key in FIGURES}):
        out.append(Difference(CERTIFICATE, message("verification.figures_hash")))
    return Compared(tuple(out), largest, moved, tuple(skipped))


def beside(stated: dict[str, Any], again: dict[str, Any]) -> tuple[list[Difference], tuple[str, ...]]:
    """Return the differences of a certificate by another method: where what does not depend on the method is not what the inputs give, and
    its figures with those of today, a line each."""
    out = _tables(stated, again, {key for key in INDEPENDENT if key in stated}) + has_its_id(stated)
    old, new = (_keyed(c["characteristics"]) for c in (stated, again))
    both = {name: (_figure(old.get(name)), _figure(new.get(name))) for name in {**old, **new}}
    lines = [message("verification.beside_figure", name=name, sealed=sealed, today=today) for name, (sealed, today) in both.items()]
    return out, (message("verification.beside", sealed=stated["method"], today=METHOD), *lines)


def has_its_id(stated: dict[str, Any]) -> list[Difference]:
    """Whether the id of a certificate is that of its content."""
    own = identification(stated)
    return [] if stated["id"] == own else [Difference(CERTIFICATE, message("verification.content_id", id=stated["id"], found=own))]


def of_environment(stated: Mapping[str, Any], here: Mapping[str, str]) -> list[Difference]:
    """What stands in a certificate as its environment and is none: where it names the sources of this program, the very keys are known."""
    out = [
        Difference(CERTIFICATE, message("verification.no_version", key=_shown(key), value=_shown(value)))
        for key, value in stated.items()
        if not isinstance(value, str) or len(value) > 80 or not _VERSION.fullmatch(value)
    ]
    if stated.get(SOURCES) == here[SOURCES]:
        out += [Difference(CERTIFICATE, message("verification.unknown_environment", key=_shown(key))) for key in stated if key not in here]
        out += [Difference(CERTIFICATE, message("verification.no_environment", key=key)) for key in here if key not in stated]
    return out


def _tables(stated: dict[str, Any], again: dict[str, Any], keys: set[str]) -> list[Difference]:
    out = []
    for key in sorted(keys):
        a, b = stated.get(key), again.get(key)
        if canonical(a) != canonical(b):
            out.append(Difference(CERTIFICATE, message("verification.other_value", key=key, stated=_shown(a), found=_shown(b))))
    return out


def _steps(a: Any, b: Any, where: str, size: float) -> Iterator[_Step]:
    """Yield where two tables differ, b being the one of today. size: against which numbers are compared, at least their own."""
    if isinstance(a, dict) and isinstance(b, dict) and set(a) == set(b):
        for key in a:
            # of a budget's row: a sensitivity is a contribution by u, and a share is a part of the whole
            own = 100.0 if key == "share_percent" else size / abs(b["u"] or 1.0) if key == "sensitivity" else size
            yield from _steps(a[key], b[key], f"{where}.{key}", own)
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        if "covariance" in where:  # what is not on its diagonal may be zero but for rounding
            size = max([size, *(abs(v) for v in _numbers(b))])
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            yield from _steps(x, y, f"{where}[{i}]", size)
    elif isinstance(a, float) and isinstance(b, float) and math.isfinite(a):
        if a != b:
            scale = max(size, abs(b))
            within = abs(a - b) <= max(RELATIVE * scale, SMALLEST if "covariance" not in where else 0.0)
            yield _Step(where, "digits" if within else "other", abs(a - b) / scale if scale else math.inf)
    elif isinstance(a, str) and isinstance(b, str):
        if a != b:
            yield _Step(where, "printed" if _texts_alike(a, b) else "other")
    elif type(a) is not type(b) or a != b:
        yield _Step(where, "other")


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, list):
        for one in value:
            yield from _numbers(one)
    elif isinstance(value, float):
        yield value


def _texts_alike(a: str, b: str) -> bool:
    """Return whether two texts are one but for the last digits of printed numbers."""
    one, other = _NUMBER.split(a), _NUMBER.split(b)
    return len(one) == len(other) and all(
        x == y or (i % 2 == 1 and _printed_alike(x, y)) for i, (x, y) in enumerate(zip(one, other, strict=True))
    )


def _printed_alike(a: str, b: str) -> bool:
    """Whether two printed numbers are one but for their last digit."""
    last = [10.0 ** -len(x.lower().split("e")[0].partition(".")[2]) for x in (a, b)]
    whole = "." not in a and "." not in b and "e" not in (a + b).lower()
    return not whole and abs(float(a) - float(b)) <= max(RELATIVE * abs(float(a)), 1.001 * max(last))


def _figure(figure: Mapping[str, Any] | None) -> str:
    if figure is None:
        return message("page.none")
    if figure["u95"] is None:
        return message("verification.result_without_u", value=figure["value"], unit=figure["unit"])
    value, u95 = with_u95(float(figure["value"]), float(figure["u95"]))
    verdict = message("certificate.capable" if figure["capable"] else "certificate.not_capable")
    return composed("{value} ± {u95} {unit}, {verdict}", value=value, u95=u95, unit=figure["unit"], verdict=verdict)


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
