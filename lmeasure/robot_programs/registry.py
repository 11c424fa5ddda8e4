"""Dialect of a program: by the suffixes of its files, or by the user's choice.

Each module states its own dialect; a new one is its file and a word in `DIALECTS`. Other packages add theirs by the entry point
`lmeasure.robot_programs` (docs/extending.md), which is read when no dialect of this program has the suffix or the name.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from lmeasure.core import RobotError, plug_in, plug_in_names, plug_ins
from lmeasure.io import Column, files
from lmeasure.robot_programs import fanuc, krl, rapid, target_tables, ur_script
from lmeasure.robot_programs.program import Dialect, Source
from lmeasure.text import message

DIALECTS = (krl.DIALECT, rapid.DIALECT, fanuc.DIALECT, ur_script.DIALECT, target_tables.CSV, target_tables.ROBODK)
GROUP = "lmeasure.robot_programs"


def opened(paths: Sequence[Path]) -> tuple[Source, ...]:
    """The files of a program, a character a byte; RobotError for one of two bytes a character."""
    sources = tuple(Source(path.name, files.read_bytes(path).decode("latin-1")) for path in paths)
    for path, source in zip(paths, sources, strict=True):
        if "\0" in source.text[:1000]:
            raise RobotError(message("error.no_text_of_a", where=path))
    return sources


def dialect_names() -> tuple[str, ...]:
    """Return the names of all dialects, of other packages too."""
    return tuple(dict.fromkeys((*(one.name for one in DIALECTS), *plug_in_names(GROUP))))


def is_dialect(name: str) -> bool:
    """Return whether there is a dialect of that name."""
    return any(one.name == name for one in DIALECTS) or name in plug_in_names(GROUP)


def dialect_of(paths: Sequence[Path], sources: Sequence[Source], name: str = "", columns: Mapping[str, Column] | None = None) -> Dialect:
    """Return the dialect of that name, or of the files' suffixes.

    Parameters
    ----------
    paths, sources
        The files of a program, and their texts.
    name
        Name of the dialect; empty if the suffixes determine it.
    columns
        Content of `--columns` for a table.

    Raises
    ------
    RobotError
        If name and suffixes determine no dialect, or columns are stated for what is no table.
    PlugInError
        If the dialect is of another package, which cannot be used.
    """
    found = _named(name) if name else _by_suffix(paths, sources[0].text, table=bool(columns))
    if columns and found.of_table is None:
        raise RobotError(message("error.columns_goes_with_tables", paths=paths[0], name=found.name))
    return found if found.of_table is None else found.of_table(sources, columns)


def _named(name: str) -> Dialect:
    found = next((one for one in DIALECTS if one.name == name), None) or plug_in(GROUP, name, Dialect)
    if found is None:
        raise RobotError(message("error.dialect_is_none_of", name=name, dialect_names=", ".join(dialect_names())))
    return found


def _by_suffix(paths: Sequence[Path], text: str, *, table: bool) -> Dialect:
    suffixes = {path.suffix.lower() for path in paths}
    fitting, broken = _having(DIALECTS, suffixes), ""
    if not fitting:
        added, broken = plug_ins(GROUP, Dialect)
        fitting = _having(added.values(), suffixes)
    if not fitting:
        names = " or ".join(dialect_names())
        raise RobotError(message("error.the_names_do_not", where=", ".join(map(str, paths)), names=names, broken=broken))
    chosen = (one for one in fitting if (table and one.of_table) or one.recognises is None or one.recognises(text))
    return next(chosen, fitting[0])


def _having(dialects: Iterable[Dialect], suffixes: set[str]) -> list[Dialect]:
    """Return the dialects that have all these suffixes."""
    return [one for one in dialects if suffixes <= set(one.suffixes)]
