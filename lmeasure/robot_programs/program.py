"""Common form of a program in every dialect: targets with the places of their numbers, frames, and unread parts.

A dialect never guesses. A position is a target if the program moves to it unchanged, in frames that the program or the user states. Every
other position or motion is listed with its line and stays unchanged.
"""

import math
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import MAX_LENGTH_MM, FloatArray, angles_from_rotation, check_kind, rotation_from_angles, se3, shortened
from lmeasure.io import Column
from lmeasure.text import Message, composed, message

NUMBER = r"[-+]?(?:\d++\.?\d*+|\.\d++)(?:[eE][-+]?\d++)?"
IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
Span = tuple[int, int]
UNIT = 1e-3
"""Largest difference of a quaternion's length from 1: programs have four decimals and more."""


@dataclass(frozen=True)
class Source:
    """A file of a program: its name, and its text, one character a byte (latin-1), so that unchanged parts stay the same byte for byte."""

    name: str
    text: str

    def line(self, place: int) -> int:
        """The number of the line of a character, from 1."""
        return bisect_right(self._line_ends, place - 1) + 1

    @cached_property
    def _line_ends(self) -> list[int]:
        return [m.start() for m in re.finditer("\n", self.text)]


@dataclass(frozen=True)
class Unread:
    """Something that was left as it is: where, and why, one line."""

    file: str
    line: int
    why: str

    @property
    def text(self) -> Message:
        """Return the whole line."""
        short = shortened(" ".join(self.why.split()))
        why = self.why if short == self.why else short
        return composed("{file}:{line}: {why}", file=self.file, line=self.line, why=why)

    def __str__(self) -> str:
        return str(self.text)


@dataclass(frozen=True)
class Target:
    """A position of a program. values: its numbers as written, in the dialect's units, spans their places in the source; joints: whether
    they are joint values; base, tool: names of its frames, of `Listing.frames`; flags: of its configuration, by name; moved: source and
    place of the first motion to it, which may differ from the target's; near: joint values in the dialect's units that the program states
    beside a pose, whose solution is the nearest to them; loose: the controller may be commanded to ignore the flags, so that the solution
    follows from the target before; taught: `near` are the joint values of the pose itself; label: the point's name in the program, if that
    is different; sizes: of the dialect's units in those of the numbers, if they differ."""

    name: str
    source: int
    line: int
    joints: bool
    values: tuple[float, ...]
    spans: tuple[Span, ...]
    base: str = ""
    tool: str = ""
    flags: Mapping[str, int] = field(default_factory=dict)
    moved: tuple[int, int] = (0, 0)
    near: tuple[float, ...] = ()
    loose: bool = False
    taught: bool = False
    label: str = ""
    sizes: tuple[float, ...] = ()


@dataclass(frozen=True)
class Dialect:
    """A language of robot programs, stated by the module that reads it: how a controller writes poses and joint values.

    Parameters
    ----------
    name
        Name, as `--dialect` takes it.
    read
        Makes a listing of the files of one program.
    pose
        base_from_tool (7,) of a target's numbers.
    numbers
        Numbers of a pose, near old ones where several say the same.
    joint_size
        rad per unit of a joint value.
    decimals
        Decimals of places, orientations and joints that are written at least.
    suffixes
        Suffixes of its files, in small letters.
    recognises
        Return whether the text of a file is of this dialect, where another has the same suffix; None: it is.
    of_table
        Makes the dialect of one table, of which `--columns` may name the columns; None for programs.
    configured
        Whether joint values (6,) [deg] have the configuration that flags state. The third argument is None, or of an elbow arm whether
        it is behind the first axis and whether its elbow is up. Signs and quarters that change within the fourth argument [deg] are not
        compared. None: flags say nothing.
    """

    name: str
    read: Callable[[Sequence[Source]], "Listing"]
    pose: Callable[[Sequence[float]], FloatArray]
    numbers: Callable[[FloatArray, Sequence[float]], FloatArray]
    joint_size: float
    decimals: tuple[int, int, int]
    suffixes: tuple[str, ...] = ()
    recognises: Callable[[str], bool] | None = None
    of_table: Callable[[Sequence[Source], Mapping[str, Column] | None], "Dialect"] | None = None
    configured: Callable[[Mapping[str, int], FloatArray, tuple[bool, bool] | None, float], bool] | None = None

    def __post_init__(self) -> None:
        check_kind(self.suffixes, self.read, self.pose, self.numbers)


@dataclass(frozen=True)
class Listing:
    """A program read: frames [mm] by name, as far as it states them; assumed: those that hold where the user states no others."""

    sources: tuple[Source, ...]
    targets: tuple[Target, ...]
    frames: Mapping[str, FloatArray]
    unread: tuple[Unread, ...]
    assumed: Mapping[str, FloatArray] = field(default_factory=dict)

    def stated(self, frames: Mapping[str, FloatArray]) -> "Listing":
        """Return it with frames that the user states; those of the program have priority. Targets without a stated frame become unread."""
        known = dict(self.assumed) | dict(frames) | dict(self.frames)
        lost, kept = list(self.unread), []
        for target in self.targets:
            missing = [] if target.joints else [name for name in (target.base, target.tool) if name not in known]
            if missing:
                lost.append(
                    Unread(
                        self.sources[target.source].name,
                        target.line,
                        message("robot_programs.frame_not_stated", name=target.name, frame=missing[0]),
                    )
                )
            else:
                kept.append(target)
        return replace(self, targets=tuple(kept), frames=known, unread=tuple(lost))


class Reader:
    """Contents of a program's files while they are read; plain: their texts without comments and strings."""

    def __init__(self, sources: Sequence[Source], comment: str = "", quotes: str = "", frames: Iterable[str] = ()) -> None:
        self.sources = tuple(sources)
        self.plain = [masked(s.text, comment, quotes) for s in sources]
        self.frames: dict[str, FloatArray] = {name: np.array(IDENTITY) for name in frames}
        self.targets: list[Target] = []
        self.unread: list[Unread] = []

    def listing(self) -> Listing:
        return Listing(self.sources, tuple(self.targets), self.frames, tuple(self.unread))

    def line(self, k: int, place: int) -> int:
        return self.sources[k].line(place)

    def where(self, k: int, place: int) -> str:
        return f"{self.sources[k].name}:{self.line(k, place)}"

    def leave(self, k: int, place: int, why: str, name: str = "") -> None:
        """Leave a position unchanged and list it; name: of the target, if the reason does not name it."""
        said = composed("{name}: {why}", name=name, why=why) if name else why
        self.unread.append(Unread(self.sources[k].name, self.line(k, place), said))

    def leave_in_several(self, k: int, place: int, name: str, used: Iterable[tuple[str, str]]) -> None:
        """Leave a target that motions go to in several frames (base, tool)."""
        frames = tuple(sorted(" / ".join(both) for both in used))
        self.leave(k, place, message("robot_programs.moved_several_frames", name=name, frames=frames))


Region = tuple[tuple[int, int, int], ...]
EVERYWHERE: Region = ()


@dataclass
class Point:
    """A declared position: its name as written, source, type and place; region, (source, start, stop) of the texts that know it, or
    everywhere; used: the frames (base, tool) that it is moved to in; first: the first motion; changed: why it is no constant."""

    name: str
    source: int
    kind: str
    span: Span
    region: Region
    used: set[tuple[str, str]] = field(default_factory=set)
    first: tuple[int, int] | None = None
    changed: str = ""

    def use(self, frames: set[tuple[str, str]], motion: tuple[int, int]) -> None:
        """Moved to by the motion at that source and place."""
        self.used |= frames
        self.first = self.first or motion

    def changes(self, why: str) -> None:
        """Note why it is no constant; the first reason counts."""
        self.changed = self.changed or why


class Points:
    """Declared positions by their names, in any case of letters."""

    def __init__(self) -> None:
        self._all: dict[str, list[Point]] = {}

    def add(self, point: Point) -> None:
        """Two of one name that are known in the same region cannot be distinguished: both become no constants."""
        same = self._all.setdefault(point.name.upper(), [])
        for other in same:
            if other.region == point.region:
                other.changed = point.changed = message("robot_programs.declared_more_than_once_2")
        same.append(point)

    def at(self, name: str, source: int, place: int) -> Point | None:
        """Return the position of that name at a place: the one known in the smallest region around it."""
        around = [(_size(p, source, place), p) for p in self._all.get(name.upper(), [])]
        known = [(size, p) for size, p in around if size is not None]
        return min(known, key=lambda one: one[0])[1] if known else None

    def __iter__(self) -> Iterator[Point]:
        return (p for same in self._all.values() for p in same)


def _size(point: Point, source: int, place: int) -> float | None:
    """Return how large the region is; None where the place is not in it."""
    if point.region == EVERYWHERE:
        return float("inf")
    there = any(k == source and start <= place <= stop for k, start, stop in point.region)
    return float(sum(stop - start for _, start, stop in point.region)) if there else None


def rewritten(listing: Listing, dialect: Dialect, values: Mapping[int, Sequence[float]]) -> tuple[str, ...]:
    """The sources' texts with the numbers of targets, by their places in the listing, replaced; nothing else differs by a byte."""
    out = []
    for k, source in enumerate(listing.sources):
        changes: list[tuple[Span, str]] = []
        for i, numbers in values.items():
            target = listing.targets[i]
            if target.source != k:
                continue
            for c, (span, number) in enumerate(zip(target.spans, numbers, strict=True)):
                least = dialect.decimals[2 if target.joints else (0 if c < 3 else 1)]
                size = target.sizes[c] if target.sizes else 1.0
                least += max(round(math.log10(size)), 0)
                changes.append((span, as_written(source.text[slice(*span)], float(number) / size, least)))
        parts, at = [], 0
        for (start, stop), text in sorted(changes):
            parts += [source.text[at:start], text]
            at = stop
        out.append("".join([*parts, source.text[at:]]))
    return tuple(out)


def as_written(old: str, value: float, least: int) -> str:
    """Return a number with the decimals of the old one, or at least so many; the old text if it is equal."""
    if "," in old:
        return as_written(old.replace(",", "."), value, least).replace(".", ",")
    if abs(float(old) - value) < 0.5 * 10.0**-least:
        return old
    decimals = least if "e" in old.lower() else max(len(old.partition(".")[2]), least)
    text = f"{value:.{decimals}f}"
    text = text[1:] if float(text) == 0.0 and text.startswith("-") else text
    return f"+{text}" if old.startswith("+") and not text.startswith("-") else text


def masked(text: str, comment: str, quotes: str = '"') -> str:
    """The text with comments, from a character to the line's end, and strings as blanks: every other character at its own place."""
    kinds = [rf"{comment}[^\n]*"] * bool(comment) + [rf"{quote}[^{quote}\n]*{quote}?" for quote in quotes]
    return re.sub("|".join(kinds), lambda m: " " * len(m[0]), text) if kinds else text


def closing(text: str, start: int, pair: str) -> int:
    """Return the place where the bracket that opens at start is closed, or -1."""
    return _closed(text, pair).get(start, -1)


@lru_cache(maxsize=64)
def _closed(text: str, pair: str) -> dict[int, int]:
    """Return the place where each bracket of a text is closed: once for all, as programs may be long."""
    out, opened = {}, list[int]()
    for m in re.finditer(f"[{re.escape(pair)}]", text):
        if m[0] == pair[0]:
            opened.append(m.start())
        elif opened:
            out[opened.pop()] = m.start()
    return out


def numbers_in(text: str, span: Span) -> list[tuple[float, Span]]:
    """Numbers of a part of a text with their places."""
    return [(float(m[0]), m.span()) for m in re.compile(rf"(?<![\w.]){NUMBER}").finditer(text, *span)]


def pieces(text: str, span: Span) -> list[Span]:
    """Parts of a list between its commas, those within brackets of any kind not counted; without blanks at their ends."""
    out, depth, start = [], 0, span[0]
    for i in range(span[0], span[1] + 1):
        if i == span[1] or (text[i] == "," and depth == 0):
            part = text[start:i]
            left = start + len(part) - len(part.lstrip())
            out.append((left, left + len(part.strip())))
            start = i + 1
        else:
            depth += (text[i] in "([{") - (text[i] in ")]}")
    return out


def wrong(values: Sequence[float], quaternion: Sequence[float] = ()) -> str:
    """Return why numbers are those of no target, empty if they may be: beyond the reach of any robot, or a quaternion that is not of length
    1."""
    for value in values:
        if not abs(value) <= MAX_LENGTH_MM:
            return message("robot_programs.number_no_robot_has", value=value)
    length = math.sqrt(sum(q * q for q in quaternion)) if len(quaternion) else 1.0
    return "" if abs(length - 1.0) <= UNIT else message("robot_programs.quaternion_length_not", length=length)


def near_turns(angles: FloatArray, old: Sequence[float]) -> FloatArray:
    """Angles with the whole turns that bring each nearest to an old one."""
    before = np.asarray(old, dtype=np.float64)
    return np.asarray(angles + 360.0 * np.round((before - angles) / 360.0))


def of_angles(convention: str) -> tuple[Callable[[Sequence[float]], FloatArray], Callable[[FloatArray, Sequence[float]], FloatArray]]:
    """(pose of numbers x, y, z and three angles; numbers of a pose near old ones). Of the two triples for one rotation the one nearer to
    the old is written, so that a corrected target looks like the one before."""

    def of(values: Sequence[float]) -> FloatArray:
        return se3.pose(values[:3], rotation_from_angles(convention, np.asarray(values[3:6], dtype=np.float64)))

    def numbers(row: FloatArray, old: Sequence[float]) -> FloatArray:
        first = angles_from_rotation(convention, se3.rotation(row))
        # Tait-Bryan: the middle angle mirrored, the outer ones half a turn further
        both = [near_turns(a, old[3:6]) for a in (first, np.array([first[0] + 180.0, 180.0 - first[1], first[2] + 180.0]))]
        # near the singular orientation only the sum of the outer angles is determined: the old first one is kept
        best = min(both, key=lambda a: float(np.abs(a - np.asarray(old[3:6])).max()))
        return np.concatenate([row[:3], best])

    return of, numbers


def of_quaternion(
    order: Sequence[int],
) -> tuple[Callable[[Sequence[float]], FloatArray], Callable[[FloatArray, Sequence[float]], FloatArray]]:
    """`of_angles` for a quaternion; order: places of x, y, z, w among its four numbers. Of both signs that of the old one is written."""

    def of(values: Sequence[float]) -> FloatArray:
        return se3.pose(values[:3], Rotation.from_quat([values[3 + i] for i in order]))

    def numbers(row: FloatArray, old: Sequence[float]) -> FloatArray:
        q = row[3:][np.argsort(order)]
        return np.concatenate([row[:3], q if q @ np.asarray(old[3:7]) >= 0.0 else -q])

    return of, numbers
