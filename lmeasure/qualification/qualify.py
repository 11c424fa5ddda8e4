"""A qualification: all checks, run on this machine, as JSON, PDF/A and a signature."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from lmeasure.certificate import canonical, environment, now, read_private_key, sign
from lmeasure.io import files
from lmeasure.qualification.checks import CHECKS, Check
from lmeasure.report import qualification_pdf
from lmeasure.text import Message, message

JSON, PDF, SIGNATURE = "qualification.json", "qualification.pdf", "signature.json"


def run_checks(progress: Callable[[int, int], None]) -> tuple[Check, ...]:
    """Run all checks; one that ends in an error has failed."""
    out = []
    for i, check in enumerate(CHECKS):
        try:
            out.append(check())
        except Exception as error:  # a planted fault may break anything
            out.append(Check(check.__name__, False, f"{type(error).__name__}: {error}"[:300], message("qualify.wanted.no_error")))
        progress(i + 1, len(CHECKS))
    return tuple(out)


def write_qualification(folder: Path, checks: tuple[Check, ...], key: Path | None) -> dict[str, Any]:
    """Write qualification.json and .pdf, and the signature of the first if there is a key; the content of the first.

    Raises
    ------
    LMeasureError
        If the key cannot be read or a file cannot be written.
    """
    private = None if key is None else read_private_key(key)
    content = {
        "schema": "lmeasure.qualification/1",
        "created": now(),
        "passed": all(c.passed for c in checks),
        "checks": [vars(c) | {"text": str(check_text(c))} for c in checks],
        "environment": environment(()),
    }
    written = canonical(content)
    files.write_bytes(folder / JSON, written)
    files.write_bytes(folder / PDF, qualification_pdf(content))
    if private is not None:
        files.write_bytes(folder / SIGNATURE, canonical(sign(written, private) | {"signed": JSON}))
    return content


def check_text(check: Check) -> Message:
    """Return what a check does, for a person."""
    return message(f"qualify.{check.code}")
