"""A certificate held against its own folder: every byte by the manifest, every figure by computing it again."""

import datetime
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lmeasure.certificate.bundle import CERTIFICATE, INPUTS, SIGNATURE, UNSIGNED, Difference, Seal, check_seal, entries, regular_bytes
from lmeasure.certificate.content import METHOD, added_in, certificate, environment
from lmeasure.certificate.inputs import Measured, inputs_in, measure, settings_from
from lmeasure.certificate.recompute import RELATIVE, SOURCES, Compared, beside, compare, label, of_environment
from lmeasure.certificate.signature import canonical
from lmeasure.core import CertificationError, DataFrame, LMeasureError, Shown, framed
from lmeasure.iso9283 import SCHEMA
from lmeasure.text import LANGUAGES, joined, message

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
    """Differences, if any; number of equal results; differences of the environment and the change that they made of the figures at most.

    skipped: what could not be compared, and why. beside: figures by another method beside today's, as lines. authorised: the name of the
    key that signed it among those that may, empty where none of them did; None where none are named.
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
    """Look at every byte, compute every figure again from the inputs, and print again what people read.

    public_key: whose signature is asked for. printers: how files such as certificate.pdf come from the certificate. They are printed again
    and compared byte for byte; where only last digits or another environment can be the reason of other bytes, by their texts, and the
    file is named as not compared beyond them. The environment is a claim of the certificate: what is not that of this machine is named as
    not compared. Figures by another method are not compared but listed beside those of today.

    All of this starts from the inputs in the folder. Whether they are those of a measurement shows only a signature: whoever changes the
    inputs of an unsigned folder can make a new certificate of them. CertificationError when there is no certificate to look at.
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
    """Return where a file that people read is not what its certificate prints, and what of it could not be compared.

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
    # other sources may say the same in other words: no difference, but nothing that was compared
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


def report_lines(found: Verification, *, asked: bool) -> list[str]:
    """Return the lines for a person: who signed it, then differences. asked: whether the signature was compared with a key."""
    out: list[str] = []
    if found.authorised is not None:
        out.append(message("verification.authorised" if found.authorised else "verification.not_authorised", name=found.authorised))
    elif found.signer is not None:
        vouched = asked and not any(d.what == SIGNATURE for d in found.differences)
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
        code = "verification.differences" if number > 1 else "verification.difference"
        out.append(message(code, certificate=found.certificate or "certificate", n=number))
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
