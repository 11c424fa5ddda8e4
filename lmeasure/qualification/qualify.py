"""A qualification: all checks, run on this machine, as JSON, PDF/A and a signature."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import typst

from lmeasure.certificate import canonical, environment, now, read_private_key, sign
from lmeasure.core import LMeasureError
from lmeasure.io import files
from lmeasure.qualification.checks import CHECKS, Check
from lmeasure.text import Message, message

JSON, PDF, SIGNATURE = "qualification.json", "qualification.pdf", "signature.json"
TEMPLATE = Path(__file__).with_name("qualification.typ")


def run_checks(progress: Callable[[int, int], None]) -> tuple[Check, ...]:
    """Run all checks; one that ends in an error has failed."""
    out = []
    for i, check in enumerate(CHECKS):
        try:
            out.append(check())
        except Exception as error:  # a planted fault may break anything
            out.append(Check(check.__name__, False, f"{type(error).__name__}: {error}"[:300], "no error"))
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
    files.write_bytes(folder / PDF, _pdf(content))
    if private is not None:
        files.write_bytes(folder / SIGNATURE, canonical(sign(written, private) | {"signed": JSON}))
    return content


def check_text(check: Check) -> Message:
    """Return what a check does, for a person."""
    return message(f"qualify.{check.code}")


def _pdf(content: dict[str, Any]) -> bytes:
    shown = {
        "title": "Software qualification report",
        "id": f"lmeasure {content['environment'].get('lmeasure', '')}, {content['created'][:10]}",
        "intro": "lmeasure ran these checks on this machine (ISO/IEC 17025:2017, 7.11.2: validation before use).",
        "head": ["Check", "Found", "Required", "Result"],
        "rows": [[c["text"], c["found"], c["wanted"], "passed" if c["passed"] else "FAILED"] for c in content["checks"]],
        "verdict": "All checks passed." if content["passed"] else "A check failed. Do not use this installation.",
        "environment_title": "Environment",
        "environment": [[str(k), str(v)] for k, v in content["environment"].items()],
    }
    inputs = {"content": json.dumps(shown)}
    try:
        return bytes(typst.compile(TEMPLATE.read_bytes(), sys_inputs=inputs, pdf_standards=["a-2b"], ignore_system_fonts=True))
    except typst.TypstError as error:
        raise LMeasureError(f"the PDF cannot be printed: {str(error).splitlines()[0]}") from None
