"""What a run folder says of how it was recorded: whether its counts are those that were recorded, and what happened meanwhile."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lmeasure.core import FileFormatError
from lmeasure.io import files
from lmeasure.text import Message, message, recognised

HARMLESS = ("duplicate", "duplicate_sync", "reordered", "wrap", "stamp", "clock_wrap", "unanswered")
"""Faults after which the counts are what they would have been without."""


@dataclass(frozen=True)
class Recorded:
    """How one pass was recorded.

    early: the recording broke off, why says for what reason; faults: how many of each kind; closure_counts: by channel, the mean of the
    last rest less that of the first, as the recorder saw it; sha256: digests of files that the recorder wrote, by name.
    """

    passage: int
    early: bool = False
    why: str = ""
    faults: Mapping[str, int] = field(default_factory=dict)
    closure_counts: Mapping[str, float] = field(default_factory=dict)
    sha256: Mapping[str, str] = field(default_factory=dict)

    def notes(self) -> list[Message]:
        """What a reader of poses must know."""
        out = []
        if self.early:
            early = {"number": self.passage}
            out.append(message("recording.early.why", **early, why=self.why) if self.why else message("recording.early", **early))
        told = [f"{n} {kind}" for kind, n in sorted(self.faults.items()) if n and kind not in HARMLESS]
        if told:
            out.append(message("recording.faults", number=self.passage, faults=tuple(recognised(one) or one for one in told)))
        return out


def recording_at(path: Path) -> bool:
    """Return whether a file is part of a recording: of a run that `record` has made, or of a campaign that `capture` has made.

    A recording is the counts and frames of a folder, and the run.toml that describes them.
    """
    folder, name = Path(path).parent, Path(path).name
    if (folder / "capture.toml").is_file():
        return name in ("capture.toml", "counts.csv")
    if not re.fullmatch(r"run\.toml|rig\.toml|pass\d+\.(csv|log|events\.csv)", name):
        return False
    try:
        entries = files.read_toml(folder / "run.toml").get("recording", [])
    except (FileFormatError, OSError):
        return False
    return any("frames" in entry for entry in entries if isinstance(entry, dict)) if isinstance(entries, list) else False


def recorded_in(data: dict[str, Any], path: Path) -> tuple[Recorded, ...]:
    """The [[recording]] tables of a run.toml; FileFormatError names one that is not what `record` and `import` write."""
    entries = data.get("recording", [])
    out = []
    for number, entry in enumerate(entries if isinstance(entries, list) else [entries], 1):
        if not isinstance(entry, dict):
            raise FileFormatError(f"{path}: recording {number}: is not a table")
        passage, why = entry.get("pass", number), entry.get("why", "")
        if isinstance(passage, bool) or not isinstance(passage, int) or not isinstance(why, str):
            raise FileFormatError(f"{path}: recording {number}: pass must be a number, why a text")
        # an import's digests are of logs that lie elsewhere, perhaps under the name of its counts
        digests = _table(entry, "sha256", str, path) if "frames" in entry else {}
        out.append(
            Recorded(
                passage,
                entry.get("ended") == "early",
                why,
                _table(entry, "faults", int, path),
                {channel: float(v) for channel, v in _table(entry, "closure_counts", int | float, path).items()},
                digests,
            )
        )
    return tuple(out)


def _table(entry: dict[str, Any], key: str, kind: Any, path: Path) -> dict[str, Any]:
    table = entry.get(key, {})
    if not isinstance(table, dict) or not all(isinstance(v, kind) and not isinstance(v, bool) for v in table.values()):
        raise FileFormatError(f"{path}: recording: {key} is not what this program writes")
    return table


def check_digests(recorded: tuple[Recorded, ...], counts: Mapping[str, Path], path: Path) -> None:
    """FileFormatError names the first of the counts files, by their names in run.toml, whose bytes are not those that were recorded."""
    for entry in recorded:
        for name, digest in entry.sha256.items():
            if name in counts and files.sha256(counts[name]) != digest.lower():
                raise FileFormatError(f"{counts[name]}: is not the file that was recorded: {path} has another SHA-256 for it")


def notes_of(recorded: tuple[Recorded, ...]) -> tuple[Message, ...]:
    """What a reader of poses must know of the recording."""
    return tuple(note for entry in recorded for note in entry.notes())
