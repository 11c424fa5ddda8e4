"""Which dialect a program is in: by the ends of its files' names, or as the user says."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from lmeasure.core import RobotError
from lmeasure.io import Column, files
from lmeasure.robot_programs import fanuc, krl, rapid, target_tables, ur_script
from lmeasure.robot_programs.program import Dialect, Source

ENDS = {
    ".src": "krl",
    ".dat": "krl",
    ".mod": "rapid",
    ".modx": "rapid",
    ".prg": "rapid",
    ".sys": "rapid",
    ".ls": "fanuc",
    ".script": "ur-script",
    ".urscript": "ur-script",
    ".csv": "csv",
}
NAMES = ("krl", "rapid", "fanuc", "ur-script", "csv", "robodk")


def opened(paths: Sequence[Path]) -> tuple[Source, ...]:
    """The files of a program, a character a byte; RobotError for one of two bytes a character."""
    sources = tuple(Source(path.name, files.read_bytes(path).decode("latin-1")) for path in paths)
    for path, source in zip(paths, sources, strict=True):
        if "\0" in source.text[:1000]:
            raise RobotError(f"{path}: no text of a controller: it has NUL bytes, as UTF-16 has; save it as plain text")
    return sources


def dialect_of(paths: Sequence[Path], sources: Sequence[Source], name: str = "", columns: Mapping[str, Column] | None = None) -> Dialect:
    """The dialect of that name, or that the files' names end with; columns: what `--columns` says of a table. RobotError where they do not
    say one."""
    if not name:
        found = {ENDS.get(path.suffix.lower(), "") for path in paths}
        if len(found) != 1 or "" in found:
            raise RobotError(f"{', '.join(map(str, paths))}: the names do not say one dialect; state --dialect {' or '.join(NAMES)}")
        name = found.pop()
        first = target_tables.header_line(sources[0].text).lower()
        if name == "csv" and not columns and not any(c in first for c in ("_mm", "_deg")):
            name = "robodk"
    if name not in NAMES:
        raise RobotError(f"dialect {name!r} is none of {', '.join(NAMES)}")
    if columns and name != "csv":
        raise RobotError(f"--columns goes with tables (.csv) and --map; {paths[0]} is read as {name}")
    fixed = {
        "krl": krl.DIALECT,
        "rapid": rapid.DIALECT,
        "fanuc": fanuc.DIALECT,
        "ur-script": ur_script.DIALECT,
        "robodk": target_tables.ROBODK,
    }
    return fixed[name] if name in fixed else target_tables.plain(target_tables.header_line(sources[0].text), columns)
