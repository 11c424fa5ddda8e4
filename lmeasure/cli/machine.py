"""`--json`: the result of a command for programs, in one form for all (docs/command-line.md)."""

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lmeasure.core import Shown
from lmeasure.text import Message
from lmeasure.workflows import COMMANDS, Result

SCHEMA = "lmeasure.result/1"
FLAG = "--json"


def enabled(words: Sequence[str] | None = None) -> bool:
    """Return whether the command line requests JSON."""
    words = sys.argv[1:] if words is None else words
    return FLAG in (words[: words.index("--")] if "--" in words else words)


def of_result(command: str, result: Result) -> dict[str, Any]:
    """Return the document of a workflow's result."""
    return _document(
        command,
        1 if result.failure else result.exit_code,
        result.failure or None,
        summary=[line for line in result.summary if line],
        figures=dict(result.figures),
        warnings=list(result.warnings),
        files=list(result.files),
        notes=_notes(result.made),
        made=_made(result),
    )


def of_error(exit_code: int, lines: Sequence[str]) -> dict[str, Any]:
    """An error in place of a result; where a file has several faults, the others are the warnings."""
    return _document(next((word for word in sys.argv[1:] if word in COMMANDS), ""), exit_code, lines[0], warnings=list(lines[1:]))


def written(document: Mapping[str, Any]) -> str:
    """Return the document as printed; NaN is null."""
    return json.dumps(_plain(document), indent=1, ensure_ascii=False, allow_nan=False)


def _document(command: str, exit_code: int, error: str | None, **given: Any) -> dict[str, Any]:
    empty: dict[str, Any] = {"summary": [], "figures": {}, "warnings": [], "files": [], "notes": [], "made": None}
    return {"schema": SCHEMA, "command": command, "exit_code": exit_code, "error": error} | empty | given


def _notes(made: Any) -> list[dict[str, str]]:
    """Return the notes of a result, each by its code if it has one."""
    return [{"code": note.code, "text": str(note)} for note in getattr(made, "notes", ()) if isinstance(note, Message)]


def _made(result: Result) -> Any:
    """Return the result: plain data, unless a file of the command contains them, and objects by their own description."""
    made = result.made
    if isinstance(made, Shown):
        return made.about()
    if isinstance(made, dict | list) and not any(path.suffix == ".json" for path in result.files):
        return made
    return None


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):  # numbers and arrays of numpy
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
