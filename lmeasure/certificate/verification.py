"""Verification of a certificate by its own folder: every byte by the manifest, every result by computing it again."""

import datetime
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from lmeasure.certificate.bundle import CERTIFICATE, INPUTS, SIGNATURE, UNSIGNED, Difference, Seal, check_seal, entries, regular_bytes
from lmeasure.certificate.content import METHOD, added_in, certificate, environment, identification
from lmeasure.certificate.inputs import Measured, inputs_in, measure, settings_from
from lmeasure.certificate.signature import canonical, digest
from lmeasure.core import CertificationError, DataFrame, LMeasureError, Shown, framed
from lmeasure.iso9283 import SCHEMA, key_of
from lmeasure.text import LANGUAGES, composed, joined, message, settled


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
    # + 0.0: a value that rounds to zero has no sign
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

    differences: entries that do not follow from the inputs. largest: largest difference of a result within the tolerance, as a part of its
    size. moved: whether anything differs in its last digits. skipped: entries without a comparison, and the reason.
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
    """Return the differences of a certificate by another method in entries that do not depend on the method, and its results with today's,
    a line each."""
    out = _tables(stated, again, {key for key in INDEPENDENT if key in stated}) + has_its_id(stated)
    old, new = (_keyed(c["characteristics"]) for c in (stated, again))
    both = {name: (_figure(old.get(name)), _figure(new.get(name))) for name in {**old, **new}}
    lines = [message("verification.beside_figure", name=name, sealed=sealed, today=today) for name, (sealed, today) in both.items()]
    return out, (message("verification.beside", sealed=stated["method"], today=METHOD), *lines)


def has_its_id(stated: dict[str, Any]) -> list[Difference]:
    """Check that the id of a certificate is that of its content."""
    own = identification(stated)
    return [] if stated["id"] == own else [Difference(CERTIFICATE, message("verification.content_id", id=stated["id"], found=own))]


def of_environment(stated: Mapping[str, Any], here: Mapping[str, str]) -> list[Difference]:
    """Check the environment of a certificate: if it names the sources of this program, the very keys are known."""
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
        if "covariance" in where:  # off-diagonal values may be zero apart from rounding
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
    """Return whether two printed numbers are equal but for their last digit."""
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


PROGRAM = ("lmeasure", "lmeasure sources")
"""Parts of an environment that are this program itself: another one prints other texts."""


@dataclass(frozen=True)
class Printer:
    """Printer of a file that people read, and the text that they read in its bytes. text: ValueError when they cannot
    be read. needed: `certify` writes it always. close: whether two of them are the same but for the last digits of numbers."""

    write: Callable[[dict[str, Any], Measured], bytes]
    text: Callable[[bytes], str]
    needed: bool = True
    close: Callable[[bytes, bytes], bool] = bytes.__eq__

    def __call__(self, content: dict[str, Any], measured: Measured) -> bytes:
        """The file's bytes."""
        return self.write(content, measured)


@dataclass(frozen=True)
class Verification:
    """Differences, if any; number of equal results; differences of the environment and the largest change of results by them.

    skipped: entries without a comparison, and the reason. beside: results by another method beside today's, as lines. authorised: the name
    of the authorised key that signed it, empty if none did; None if no keys are named.
    """

    certificate: str
    differences: tuple[Difference, ...]
    figures: int = 0
    signer: str | None = None
    environment: tuple[str, ...] = ()
    largest: float = 0.0
    skipped: tuple[str, ...] = field(default=())
    beside: tuple[str, ...] = field(default=())
    authorised: str | None = None

    @property
    def exit_code(self) -> int:
        """0 the same, 1 a difference or no authorised signer, 3 no difference but something that could not be compared."""
        return 1 if self.differences or self.authorised == "" else 3 if self.skipped else 0


def verify(
    folder: Path,
    public_key: Any | None = None,
    printers: Mapping[str, Printer] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Verification:
    """Check every byte, compute every result again from the inputs, and print its pages again.

    public_key: the key of the required signature. printers: functions that print files such as certificate.pdf. They are printed again and
    compared byte for byte. If last digits or another environment explain other bytes, their texts are compared, and the file is named as
    not compared beyond them. The environment is a claim of the certificate: differences from this machine are named as not compared.
    Results by another method are listed beside today's, not compared.

    All of this starts from the inputs in the folder. Only a signature shows that they are those of a measurement: anyone can change the
    inputs of an unsigned folder and make a new certificate. CertificationError without a certificate.
    """
    folder = Path(folder)
    seal = check_seal(folder, public_key)
    if any(d.what.startswith(f"{INPUTS}/") for d in seal.differences):
        return Verification(
            seal.certificate, seal.differences, signer=seal.signer, skipped=(message("certificate.figures_inputs_not_those"),)
        )
    try:
        stated = read_certificate(folder / CERTIFICATE)
    except LMeasureError as error:
        return _not_computed(folder, seal, error)
    here = environment(added_in(stated["environment"]))
    own = {key: value for key, value in here.items() if stated["environment"].get(key) != value}
    own |= {key: message("verification.not_here") for key in stated["environment"] if key not in here}
    method = stated["method"]
    other = method != METHOD
    unknown = message("verification.not_stated")
    reported = tuple(
        message("verification.differs", key=key, stated=stated["environment"].get(key, unknown), here=value) for key, value in own.items()
    )
    out = [*seal.differences, *of_environment(stated["environment"], here)]
    if seal.certificate and stated["id"] != seal.certificate:
        out.append(Difference(CERTIFICATE, message("verification.other_id", id=stated["id"], manifest=seal.certificate)))
    try:
        inputs = inputs_in(folder, stated["measurement"])
        copies = entries(folder, sorted(inputs.copies()))
        measured = measure(inputs, settings_from(stated["settings"], earlier=other), progress, same=not other)
    except LMeasureError as error:
        if not other:
            return _not_computed(folder, seal, error)
        why = message("verification.refuses", method=method, today=METHOD, why=_inside(folder, error))
        return Verification(stated["id"], tuple(out), signer=seal.signer, environment=reported, skipped=(why,))
    out += _strangers(seal, {c["file"] for c in copies}, printers)
    again = certificate(measured, inputs, copies, created=stated["created"], language=stated["language"], environment=stated["environment"])
    lines: tuple[str, ...] = ()
    skipped: list[str] = []
    figures, compared = 0, Compared(())
    if own:
        skipped.append(message("verification.environment", what=joined(reported)))
    if other:
        found, lines = beside(stated, again)
        out += found
        skipped.append(message("certificate.figures_made_method_todays", method=method, today=METHOD))
    else:
        compared = compare(stated, again, other_version=SOURCES in own)
        out += compared.differences
        skipped += compared.skipped
        figures = len(stated["characteristics"])
    for name, printer in (printers or {}).items():
        if any(d.what == name for d in seal.differences):
            continue
        found, why_not = _page(folder, name, printer, stated=stated, measured=measured, own=own, other=other, moved=compared.moved)
        out += found
        skipped += why_not
    return Verification(stated["id"], tuple(out), figures, seal.signer, reported, compared.largest, tuple(skipped), lines)


def _not_computed(folder: Path, seal: Seal, error: Exception) -> Verification:
    out = seal.differences or (Difference(CERTIFICATE, message("verification.not_recomputed", why=_inside(folder, error))),)
    return Verification(seal.certificate, out, signer=seal.signer, skipped=(message("certificate.figures_see_above"),))


def _inside(folder: Path, error: Exception) -> str:
    return str(error).replace(f"{folder}/", "")


def _strangers(seal: Seal, inputs: set[str], printers: Mapping[str, Printer] | None) -> list[Difference]:
    """Files that the manifest names and that are no part of a certificate."""
    if printers is None:
        return [Difference(n, message("verification.no_input")) for n in sorted(seal.files - inputs) if n.startswith(f"{INPUTS}/")]
    return [Difference(name, message("verification.no_part")) for name in sorted(seal.files - inputs - {CERTIFICATE, *printers})]


def _page(
    folder: Path,
    name: str,
    printer: Printer,
    *,
    stated: dict[str, Any],
    measured: Measured,
    own: Mapping[str, str],
    other: bool,
    moved: bool,
) -> tuple[list[Difference], list[str]]:
    """Return the differences of a printed file from its certificate, and the parts without a comparison.

    moved: figures differ in their last digits, which are in the pictures too.
    """
    if not (folder / name).exists():
        return [], [message("verification.not_in_folder", name=name)] if printer.needed else []
    why_not: list[str] = [message("verification.other_texts", name=name)]
    if other:
        return [], why_not
    content, expected = regular_bytes(folder / name), printer(stated, measured)
    if content == expected or (moved and printer.close(content, expected)):
        return [], []
    if own or moved:
        try:
            if printer.text(content) == printer.text(expected):
                return [], [message("verification.by_text", name=name)]
        except ValueError as error:
            return [Difference(name, message("verification.unreadable", why=str(error)))], []
    # sources of another version may have other texts: not a difference, but not compared either
    if any(key in own for key in PROGRAM):
        return [], why_not
    return [Difference(name, message("verification.other_print"))], []


def read_certificate(path: Path) -> dict[str, Any]:
    """A certificate.json as a dictionary whose tables are there; FileFormatError or CertificationError when it is none."""
    raw = regular_bytes(path)
    try:
        content = json.loads(raw, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise CertificationError(message("error.is_not_json", where=path, error=error)) from None
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise CertificationError(message("error.is_not_a_certificate", where=path, schema=SCHEMA))
    kinds: dict[str, Any] = {
        "id": str, "created": str, "language": str, "details": dict, "measurement": dict, "inputs": list, "settings": dict,
        "environment": dict, "trajectory": dict, "characteristics": list, "excluded": list, "attained": list, "notes": list,
        "figures_sha256": str,
    }  # fmt: skip
    for key, kind in kinds.items():
        if not isinstance(content.get(key), kind):
            raise CertificationError(message("error.is_missing_or_not", where=path, key=key))
    try:
        datetime.datetime.fromisoformat(content["created"])
    except ValueError:
        raise CertificationError(message("error.created_is_not_a", where=path)) from None
    method = content.get("method")
    if type(method) is not int or method < 1:
        raise CertificationError(message("error.method_is_not_a", where=path))
    if content["language"] not in LANGUAGES:
        raise CertificationError(message("error.language_is_not_one", where=path, languages=", ".join(LANGUAGES)))
    findings = content.get("findings", [])
    if not isinstance(findings, list) or not all(isinstance(f, dict) and isinstance(f.get("text"), str) for f in findings):
        raise CertificationError(message("error.findings_are_not_texts", where=path))
    for figure in content["characteristics"]:
        if not isinstance(figure, dict) or not {"name", "value", "unit", "u95", "capable"} <= set(figure):
            raise CertificationError(message("error.a_characteristic_lacks_its", where=path))
        numbers = [figure["value"], *([] if figure["u95"] is None and figure["capable"] is None else [figure["u95"]])]
        if not all(isinstance(number, int | float) and math.isfinite(number) for number in numbers):
            raise CertificationError(message("error.value_and_u95_must", where=path, label=label(figure)))
    if canonical(content) != raw:
        raise CertificationError(message("error.is_not_written_as_lmeasure", where=path))
    return content


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is not a number of JSON")


def report_lines(found: Verification, *, requested: bool) -> list[str]:
    """Return lines with the signer, then differences. asked: whether the signature was compared with a key."""
    out: list[str] = []
    if found.authorised is not None:
        out.append(message("verification.authorised" if found.authorised else "verification.not_authorised", name=found.authorised))
    elif found.signer is not None:
        vouched = requested and not any(d.what == SIGNATURE for d in found.differences)
        out.append(message("verification.asked" if vouched else "verification.nobody", signer=found.signer[:16]))
    elif not any(d.what == SIGNATURE and d.text != UNSIGNED for d in found.differences):
        out.append(message("certificate.unsigned_origin_not_proved"))
    out += [d.line() for d in found.differences]
    out += found.beside
    out += [message("certificate.not_compared", text=text) for text in found.skipped]
    if found.largest > 0.0:
        out.append(message("certificate.figures_differ_their_last", found=found.largest, limit=RELATIVE))
    digit = message("verification.within", limit=RELATIVE) if found.largest > 0.0 else message("verification.digit")
    computed = message("verification.computed", n=found.figures, digit=digit) if found.figures else ""
    if found.differences or found.authorised == "":
        number = len(found.differences) + (found.authorised == "")
        out.append(message("verification.differences", certificate=found.certificate or "certificate", n=number))
    elif found.skipped:
        out.append(message("verification.skipped", certificate=found.certificate, computed=computed, n=len(found.skipped)))
    else:
        out.append(message("verification.same", certificate=found.certificate, computed=computed))
    return out


@dataclass(frozen=True, repr=False)
class Certificate(Shown):
    """Sealed folder of a certificate with its certificate.json. Call `verify` before you rely on it.

    Examples
    --------
    >>> lm.Certificate.read("certificate").content["id"]  # doctest: +SKIP
    '0b6f7c52'
    """

    folder: Path
    """Folder of the certificate."""
    content: dict[str, Any]
    """Content of certificate.json."""

    @classmethod
    def read(cls, folder: Path) -> "Certificate":
        """The certificate of a folder; CertificationError or FileFormatError where it is none."""
        return cls(Path(folder), read_certificate(Path(folder) / CERTIFICATE))

    def about(self) -> dict[str, str]:
        """Number, figures, of how many the instrument is capable, where it lies."""
        figures = self.content["characteristics"]
        capable = sum(bool(f["capable"]) for f in figures)
        return {"id": self.content["id"], "characteristics": str(len(figures)), "capable": str(capable), "folder": str(self.folder)}

    def to_frame(self) -> DataFrame:
        """A row for each characteristic."""
        return framed(self.content["characteristics"])
