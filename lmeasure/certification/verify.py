"""A certificate held against its own folder: every byte by the manifest, every figure by computing it again."""

import datetime
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lmeasure import files
from lmeasure.certification.bundle import CERTIFICATE, INPUTS, SIGNATURE, Difference, check_seal, entries
from lmeasure.certification.canonical import canonical
from lmeasure.certification.certificate import LANGUAGES, certificate, identification
from lmeasure.certification.environment import environment
from lmeasure.certification.evaluate import SCHEMA
from lmeasure.certification.measure import Measured, inputs_in, measure, settings_from
from lmeasure.errors import CertificationError, LMeasureError

Printer = Callable[[dict[str, Any], Measured], bytes]

RELATIVE = 1e-6
"""Another processor or other versions may change the last digits: up to this part of the figure or of its U95, whichever is larger."""


@dataclass(frozen=True)
class Verification:
    """What is different, if anything; how many figures agree; in what the environment differs and what that made of the figures at most."""

    certificate: str
    differences: tuple[Difference, ...]
    figures: int = 0
    signer: str | None = None
    environment: tuple[str, ...] = ()
    largest: float = 0.0
    skipped: tuple[str, ...] = field(default=())


def verify(
    folder: Path,
    public_key: Any | None = None,
    printers: Mapping[str, Printer] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Verification:
    """Look at every byte, compute every figure again from the inputs, and print again what people read.

    public_key: whose signature is asked for. printers: how files such as certificate.pdf come from the certificate; they are compared
    where the environment is the same. CertificationError when there is no certificate to look at.
    """
    folder = Path(folder)
    seal = check_seal(folder, public_key)
    out = list(seal.differences)
    changed = {d.what for d in out}
    if any(name.startswith(f"{INPUTS}/") for name in changed):
        return Verification(seal.certificate, tuple(out), signer=seal.signer, skipped=("figures: the inputs are not those certified",))
    try:
        stated = read_certificate(folder / CERTIFICATE)
        own = {key: value for key, value in environment().items() if stated["environment"].get(key) != value}
        inputs = inputs_in(folder, stated["measurement"])
        copies = entries(folder, sorted(inputs.copies()))
        measured = measure(inputs, settings_from(stated["settings"]), progress)
    except LMeasureError as error:
        if not out:
            out.append(Difference(CERTIFICATE, f"cannot be computed again: {str(error).replace(f'{folder}/', '')}"))
        return Verification(seal.certificate, tuple(out), signer=seal.signer, skipped=("figures: see above",))
    again = certificate(
        measured,
        inputs,
        copies,
        created=stated["created"],
        language=stated["language"],
        environment=stated["environment"],
    )
    found, largest = compare(stated, again, exact=not own)
    out += found
    if seal.certificate and stated["id"] != seal.certificate:
        out.append(Difference(CERTIFICATE, f"its id {stated['id']} is not that of the manifest, {seal.certificate}"))
    skipped = []
    for name, printer in (printers or {}).items():
        if name in changed or not (folder / name).exists():
            continue
        if own:
            skipped.append(f"{name}: what it prints is not compared, since other versions print other bytes")
        elif printer(stated, measured) != files.read_bytes(folder / name):
            out.append(Difference(name, "does not print what certificate.json says"))
    return Verification(
        stated["id"],
        tuple(out),
        len(stated["characteristics"]),
        seal.signer,
        tuple(f"{key} {stated['environment'].get(key, 'unknown')}, here {value}" for key, value in own.items()),
        largest,
        tuple(skipped),
    )


def read_certificate(path: Path) -> dict[str, Any]:
    """A certificate.json as a dictionary whose tables are there; FileFormatError or CertificationError when it is none."""
    raw = files.read_bytes(path)
    try:
        content = json.loads(raw, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise CertificationError(f"{path}: is not JSON: {error}") from None
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise CertificationError(f"{path}: is not a certificate (schema {SCHEMA!r})")
    kinds: dict[str, Any] = {
        "id": str, "created": str, "language": str, "details": dict, "measurement": dict, "inputs": list, "settings": dict,
        "environment": dict, "trajectory": dict, "characteristics": list, "excluded": list, "attained": list, "notes": list,
        "figures_sha256": str,
    }  # fmt: skip
    for key, kind in kinds.items():
        if not isinstance(content.get(key), kind):
            raise CertificationError(f"{path}: {key} is missing or not what it should be")
    try:
        datetime.datetime.fromisoformat(content["created"])
    except ValueError:
        raise CertificationError(f"{path}: created is not a date") from None
    if content["language"] not in LANGUAGES:
        raise CertificationError(f"{path}: language is not one of {', '.join(LANGUAGES)}")
    for figure in content["characteristics"]:
        if not isinstance(figure, dict) or not {"name", "value", "unit", "u95", "capable"} <= set(figure):
            raise CertificationError(f"{path}: a characteristic lacks its name, value, unit, u95 or capable")
        if not all(isinstance(figure[key], int | float) and math.isfinite(figure[key]) for key in ("value", "u95")):
            raise CertificationError(f"{path}: {label(figure)}: value and u95 must be finite numbers")
    return content


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is not a number of JSON")


def label(figure: Mapping[str, Any]) -> str:
    """A characteristic by name, for a person: AP_p of P1."""
    where = " ".join(str(figure[key]) for key in ("pose", "path", "part") if figure.get(key) is not None)
    return f"{figure['name']} of {where}" if where else str(figure["name"])


def compare(stated: dict[str, Any], again: dict[str, Any], *, exact: bool) -> tuple[list[Difference], float]:
    """Where a certificate is not the one its inputs give, figure by figure, and the largest relative difference of a figure.

    exact: every digit counts; else figures may differ by `RELATIVE`.
    """
    out: list[Difference] = []
    largest = 0.0
    old, new = (_keyed(c["characteristics"]) for c in (stated, again))
    out += [Difference(name, "is certified, but the inputs do not give it") for name in old if name not in new]
    out += [Difference(name, "is not certified, but the inputs give it") for name in new if name not in old]
    for name, figure in old.items():
        other = new.get(name, figure)
        for key in sorted({*figure, *other}):
            a, b = figure.get(key), other.get(key)
            part = _relative(a, b, max(abs(figure["value"]), abs(figure["u95"]))) if canonical(a) != canonical(b) else 0.0
            largest = max(largest, part)
            if part > (0.0 if exact else RELATIVE):
                out.append(Difference(name, f"{key} is certified as {_shown(a)}, computed again {_shown(b)}"))
    later = set() if exact else set(again) - set(stated)  # tables that an earlier version did not write
    for key in sorted({*stated, *again} - {"characteristics", "figures_sha256", "id"} - later):
        if canonical(_told(stated, key, exact)) != canonical(_told(again, key, exact)):
            out.append(Difference(CERTIFICATE, f"{key} is {_shown(stated.get(key))}, computed again {_shown(again.get(key))}"))
    if stated["id"] != identification(stated):
        out.append(Difference(CERTIFICATE, f"id is {stated['id']}, but its content gives {identification(stated)}"))
    if exact and not out and stated["figures_sha256"] != again["figures_sha256"]:
        out.append(Difference(CERTIFICATE, "figures_sha256 is not that of its figures"))
    return out, largest if math.isfinite(largest) else 0.0


def _told(content: dict[str, Any], key: str, exact: bool) -> Any:
    """A table of a certificate; without its last digits where another environment may change them."""
    value = content.get(key)
    if exact or value is None:
        return value
    if key == "excluded":
        return [[e.get("kind"), e.get("name")] for e in value if isinstance(e, dict)]
    if key == "base_from_program":
        return [round(x, 5) if isinstance(x, float) else x for x in value]
    if key == "attained":
        return [[e.get("pose"), e.get("cycles")] for e in value if isinstance(e, dict)]
    return len(value) if key == "notes" else value


def _relative(a: Any, b: Any, size: float) -> float:
    """Difference of two entries as a part of the figure's size; infinite where they are no numbers."""
    if isinstance(a, dict) and isinstance(b, dict) and set(a) == set(b):
        return max((_relative(a[k], b[k], size) for k in a), default=0.0)
    if all(isinstance(x, int | float) and not isinstance(x, bool) for x in (a, b)):
        return abs(a - b) / max(size, abs(a)) if a != b else 0.0
    return 0.0 if a == b else math.inf


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


def told(found: Verification, *, asked: bool) -> list[str]:
    """What a person is told: differences first. asked: whether the signature was held against a key."""
    out = [str(d) for d in found.differences]
    out += [f"not compared: {text}" for text in found.skipped]
    if found.signer is not None:
        whose = (
            "the key asked for" if asked and not any(d.what == SIGNATURE for d in found.differences) else "a key nobody vouches for here"
        )
        out.append(f"signed by {found.signer[:16]}: {whose}")
    elif not any(d.what == SIGNATURE for d in found.differences):
        out.append("not signed: who made this folder is not shown by it")
    if found.environment:
        out += [f"computed with {text}" for text in found.environment]
        out.append(f"largest relative difference of a figure {found.largest:.2g}, allowed here {RELATIVE:g}")
    if found.differences:
        number = len(found.differences)
        out.append(f"{found.certificate or 'certificate'}: {number} difference{'s' if number > 1 else ''}")
    else:
        digit = "to the digit" if not found.environment else f"within {RELATIVE:g}"
        out.append(f"{found.certificate}: every byte as sealed, all {found.figures} figures computed again and the same {digit}")
    return out
