"""ABB RAPID (.mod, .prg): robtarget and jointtarget with wobjdata and tooldata; confdata is read, not changed.

Read: declared targets and literals in Move and Trigg instructions. A work object is uframe times oframe and stands still; a tool is held
by the robot. Numbers of an orientation are q1 (the scalar), q2, q3, q4.
"""

import math
import re
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure import se3
from lmeasure.arrays import FloatArray
from lmeasure.robots.dialects.program_text import (
    IDENTITY,
    NUMBER,
    Dialect,
    Listing,
    Source,
    Span,
    Target,
    Unread,
    closing,
    masked,
    pieces,
    pose,
)

_DECLARED = re.compile(r"\b(?:CONST|PERS|VAR)\s+(robtarget|jointtarget|tooldata|wobjdata)\s+(\w+)\s*(\{[^}]*\})?\s*:=\s*(?=\[)", re.I)
_MOVE = re.compile(r"\b(Move(?:Abs)?(?:J|L|C)(?:DO|AO|GO|Sync)?|Trigg(?:J|L|C)|Search(?:L|C))\b\s*", re.I)
_ASSIGNED = re.compile(r"(?:^|;|\bTHEN\b|\bDO\b|\bELSE\b)\s*(\w+)\s*(?:\{[^}]*\}|\.\s*\w+)*\s*:=", re.M | re.I)
_GIVEN = re.compile(r"(?:^|;|\bTHEN\b|\bDO\b|\bELSE\b)\s*(\w+)\s+([^;:=]*);", re.M | re.I)
_DISPLACED = re.compile(r"\b(PDispOn|PDispSet|EOffsOn|EOffsSet)\b", re.I)
_WORDS = "constpersvarlocaltaskmodulesysmoduleprocfunctraprecordaliasreturnraiseexitretrytrynext"
_BOTH = ("movec", "triggc", "searchc")


def read(sources: Sequence[Source]) -> Listing:
    """The targets of a program's modules together."""
    return _Reader(sources).listing()


class _Reader:
    def __init__(self, sources: Sequence[Source]) -> None:
        self.sources = tuple(sources)
        self.plain = [masked(s.text, "!") for s in sources]
        self.points: dict[str, tuple[int, str, str, Span]] = {}
        self.frames: dict[str, FloatArray] = {"wobj0": np.array(IDENTITY), "tool0": np.array(IDENTITY)}
        self.used: dict[str, set[tuple[str, str]]] = {}
        self.first: dict[str, tuple[int, int]] = {}
        self.changed: dict[str, str] = {}
        self.targets: list[Target] = []
        self.unread: list[Unread] = []

    def listing(self) -> Listing:
        for k, text in enumerate(self.plain):
            for m in _DECLARED.finditer(text):
                self._declared(k, m)
        for k, text in enumerate(self.plain):
            self._changed(k, text)
        for k, text in enumerate(self.plain):
            for m in _MOVE.finditer(text):
                self._moved(k, m)
        for key, (k, name, _, span) in self.points.items():
            used = self.used.get(key, set())
            if not used:
                self._leave(k, span[0], f"{name}: no motion goes to it as it stands")
            elif key in self.changed:
                self._leave(k, span[0], f"{name}: {self.changed[key]}")
            elif len(used) > 1:
                self._leave(k, span[0], f"{name}: moved to in several frames: {', '.join(sorted(' / '.join(u) for u in used))}")
            else:
                self._take(k, name, span, next(iter(used)))
        return Listing(self.sources, tuple(self.targets), self.frames, tuple(self.unread))

    def _changed(self, k: int, text: str) -> None:
        """What the program changes while it runs is no constant, and where a routine that is given a target moves to it is not told; all
        targets are elsewhere where a displacement may be on."""
        for m in _ASSIGNED.finditer(text):
            self._mark(k, m[1], m.start(1), "is changed by the program")
            self.frames.pop(m[1].lower(), None)
        for m in _GIVEN.finditer(text):
            if not _MOVE.match(m[1]) and m[1].lower() not in _WORDS:
                for word in re.findall(r"\w+", m[2]):
                    self._mark(k, word, m.start(1), f"is passed to {m[1]}")
        displaced = _DISPLACED.search(text)
        for name in self.points if displaced else ():
            assert displaced is not None
            if self.points[name][2] == "robtarget":
                self._mark(k, name, displaced.start(), f"a displacement may be on, by {displaced[1]}")

    def _mark(self, k: int, name: str, place: int, why: str) -> None:
        if name.lower() in self.points:
            self.changed.setdefault(name.lower(), f"{why} in {self.sources[k].name}:{self.sources[k].line(place)}")

    def _declared(self, k: int, m: re.Match[str]) -> None:
        text, kind, name = self.plain[k], m[1].lower(), m[2]
        span = m.end(), closing(text, m.end(), "[]")
        if span[1] < 0:
            self._leave(k, m.start(), f"{name}: a list that is not closed")
        elif m[3]:
            self._leave(k, m.start(), f"{name}: an array of {kind}")
        elif kind in ("robtarget", "jointtarget"):
            self.points[name.lower()] = (k, name, kind, span)
        else:
            self._stated(k, kind, name, span)

    def _stated(self, k: int, kind: str, name: str, span: Span) -> None:
        """A tool or a work object; where it cannot be read, or moves, targets in it are left for want of it."""
        text = self.plain[k]
        parts = pieces(text, (span[0] + 1, span[1]))
        words = [text[slice(*p)].upper() for p in parts]
        if kind == "tooldata":
            held, frames = words[:1] == ["TRUE"], parts[1:2]
        else:
            held, frames = words[:2] == ["FALSE", "TRUE"], parts[3:5]
        found = [self._frame(k, p) for p in frames]
        if not held:
            self._leave(k, span[0], f"{name}: {'a tool that stands still' if kind == 'tooldata' else 'a work object that moves'}")
        elif not found or any(f is None for f in found):
            self._leave(k, span[0], f"{name}: a frame that is no list of numbers")
        else:
            total = np.array(IDENTITY)
            for one in found:
                assert one is not None
                total = se3.compose(total, one)
            self.frames[name.lower()] = total

    def _frame(self, k: int, span: Span) -> FloatArray | None:
        values = self._lists(k, span)
        return None if values is None or [len(v) for v in values[:2]] != [3, 4] else _pose([v for part in values[:2] for v, _ in part])

    def _moved(self, k: int, m: re.Match[str]) -> None:
        text, move = self.plain[k], m[1]
        end = text.find(";", m.end())
        if end < 0:
            self._leave(k, m.start(), f"{move}: an instruction that is not closed")
            return
        arguments = [p for p in pieces(text, (m.end(), end)) if text[p[0] : p[1]]]
        plain = [p for p in arguments if text[p[0]] != "\\"]
        targets = plain[: 2 if move.lower() in _BOTH else 1]
        rest = text[m.end() : end]
        tools = [re.match(r"\w+", text[slice(*p)]) for p in plain[-1:]]
        tool = tools[0][0].lower() if tools and tools[0] and len(plain) > len(targets) else ""
        wobj = re.search(r"\\\s*WObj\s*:=\s*(\w+)", rest, re.I)
        frames = (wobj[1].lower() if wobj else "wobj0"), tool
        for start, stop in targets:
            operand = re.sub(r"\\.*", "", text[start:stop]).strip()
            if operand.startswith("[") and any(_DISPLACED.search(t) for t in self.plain):
                self._leave(k, start, f"{move} of line {self.sources[k].line(start)}: a displacement may be on")
            elif operand.startswith("["):
                self._take(k, f"{move} of line {self.sources[k].line(start)}", (start, start + len(operand) - 1), frames)
            elif operand.lower() in self.points:
                self.first.setdefault(operand.lower(), (k, start))
                self.used.setdefault(operand.lower(), set()).add(("wobj0", "tool0") if move.lower().startswith("moveabs") else frames)
            elif re.fullmatch(r"\w+", operand):
                self._leave(k, start, f"{move} {operand}: is not declared here")
            else:
                self._leave(k, start, f"{move} {operand}: a target that is computed")

    def _take(self, k: int, name: str, span: Span, frames: tuple[str, str]) -> None:
        values = self._lists(k, span)
        if values is None:
            self._leave(k, span[0], f"{name}: a list with what is no number")
            return
        shape = [len(v) for v in values]
        place, moved = self.sources[k].line(span[0]), self.first.get(name.lower(), (k, span[0]))
        if shape == [6, 6]:
            numbers, spans = zip(*values[0], strict=True)
            self.targets.append(Target(name, k, place, True, numbers, spans, *frames, moved=moved))
        elif shape == [3, 4, 4, 6]:
            numbers, spans = zip(*values[0], *values[1], strict=True)
            flags = dict(zip(("cf1", "cf4", "cf6", "cfx"), (int(v) for v, _ in values[2]), strict=True))
            self.targets.append(Target(name, k, place, False, numbers, spans, *frames, flags, moved))
        else:
            self._leave(k, span[0], f"{name}: neither a robtarget nor a jointtarget")

    def _lists(self, k: int, span: Span) -> list[list[tuple[float, Span]]] | None:
        """Lists of numbers within a list, with their places; None where anything else stands there."""
        text = self.plain[k]
        out = []
        for start, stop in pieces(text, (span[0] + 1, closing(text, span[0], "[]"))):
            if not text[start:stop].startswith("["):
                return None
            inner = []
            for part in pieces(text, (start + 1, stop - 1)):
                if not re.fullmatch(NUMBER, text[slice(*part)]):
                    return None
                inner.append((float(text[slice(*part)]), part))
            out.append(inner)
        return out

    def _leave(self, k: int, place: int, why: str) -> None:
        self.unread.append(Unread(self.sources[k].name, self.sources[k].line(place), why))


def _pose(values: Sequence[float]) -> FloatArray:
    w, x, y, z = values[3:7]
    return pose(values[:3], Rotation.from_quat([x, y, z, w]))


def _numbers(row: FloatArray, old: Sequence[float]) -> FloatArray:
    x, y, z, w = row[3:]
    q = np.array([w, x, y, z])
    return np.concatenate([row[:3], q if q @ np.asarray(old[3:7]) >= 0.0 else -q])


DIALECT = Dialect("rapid", read, _pose, _numbers, math.radians(1.0), (4, 9, 5), ("wobj0", "tool0"))
