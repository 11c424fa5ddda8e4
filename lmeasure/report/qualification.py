"""A qualification on paper, by typst."""

import json
from pathlib import Path
from typing import Any

import typst

from lmeasure.core import LMeasureError
from lmeasure.text import message

TEMPLATE = Path(__file__).with_name("qualification.typ")


def qualification_pdf(content: dict[str, Any]) -> bytes:
    """Return the PDF/A of a qualification.

    Raises
    ------
    LMeasureError
        If it cannot be printed.
    """
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
        raise LMeasureError(message("error.the_pdf_cannot_be_printed", error=str(error).splitlines()[0])) from None
