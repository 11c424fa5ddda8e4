"""One text for one value: JSON whose bytes can be compared and digested."""

import hashlib
import json
import math
from typing import Any

from lmeasure.core import CertificationError


def canonical(value: Any) -> bytes:
    """The value as JSON in UTF-8; doubles as the shortest text that reads back to the same one, at most 17 digits.

    CertificationError names the place of a number that is not finite.
    """
    _only_finite(value, "")
    return (json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode("utf-8", "backslashreplace")


def digest(value: Any) -> str:
    """SHA-256 of the canonical text, hexadecimal."""
    return hashlib.sha256(canonical(value)).hexdigest()


def _only_finite(value: Any, where: str) -> None:
    if isinstance(value, dict):
        for key, inner in value.items():
            _only_finite(inner, f"{where}.{key}" if where else str(key))
    elif isinstance(value, list | tuple):
        for i, inner in enumerate(value):
            _only_finite(inner, f"{where}[{i}]")
    elif isinstance(value, float) and not math.isfinite(value):
        raise CertificationError(f"{where} is {value}, not a finite number")
