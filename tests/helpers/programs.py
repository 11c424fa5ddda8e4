"""Small programs as controllers hold them, with what is to be left among what is a target, in programs/small."""

from pathlib import Path

import numpy as np

from lmeasure.robot_programs import Dialect, Listing, Source, dialect_of

FOLDER = Path(__file__).parents[1] / "robot_programs" / "programs"
WHOLE = {
    "krl": ("tend.src", "tend.dat"), "rapid": ("Polish.mod",), "fanuc": ("DECK.LS",), "ur-script": ("palletise.script",),
    "csv": ("targets.csv",), "robodk": ("robodk.csv",),
}  # fmt: skip
SMALL = {"krl": ("pick.src", "pick.dat"), "rapid": ("cell.mod",), "fanuc": ("pick.ls",), "ur-script": ("pick.script",)}
ALL = {name: tuple((file, (FOLDER / "small" / file).read_text(encoding="utf-8")) for file in files) for name, files in SMALL.items()}
(_, KRL_SOURCE), (_, KRL_DATA) = ALL["krl"]
((_, RAPID),), ((_, FANUC),), ((_, UR),) = ALL["rapid"], ALL["fanuc"], ALL["ur-script"]


def homogeneous(place: list[float], turn: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn, place
    return out


def about(axis: int, degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    out = np.eye(3)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    out[i, i] = out[j, j] = c
    out[i, j], out[j, i] = -s, s
    return out


def listed(name: str, sources: tuple[tuple[str, str], ...] | None = None) -> tuple[Dialect, Listing]:
    """A program, one of these or of given names and texts, as its dialect reads it."""
    files = tuple(Source(n, t) for n, t in (sources or ALL[name]))
    dialect = dialect_of([Path(n) for n, _ in (sources or ALL[name])], files)
    assert dialect.name == name
    return dialect, dialect.read(files)
