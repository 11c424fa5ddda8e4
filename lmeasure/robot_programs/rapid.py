"""ABB RAPID (.mod, .prg): robtarget and jointtarget with wobjdata and tooldata; confdata is read, not changed.

Read: declared targets and literals in Move and Trigg instructions, of several of one name the one that the routine or module knows. A work
object is uframe times oframe and is fixed; a tool is on the robot. Numbers of an orientation are q1 (the scalar), q2, q3, q4. Poses with
external axes elsewhere than at 0 stay unchanged.
"""

import math
import re
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import zip_longest

import numpy as np

from lmeasure.core import FloatArray, se3
from lmeasure.robot_programs.program import (
    EVERYWHERE,
    IDENTITY,
    NUMBER,
    Dialect,
    Listing,
    Point,
    Points,
    Reader,
    Region,
    Source,
    Span,
    Target,
    closing,
    of_quaternion,
    pieces,
    wrong,
)
from lmeasure.text import message

_DECLARED = re.compile(
    r"\b((?:LOCAL\s+|TASK\s+)?)(?:CONST|PERS|VAR)\s+(robtarget|jointtarget|tooldata|wobjdata)\s++(\w++)\s*+(\{[^{};]*\})?\s*+:=\s*+(?=\[)",
    re.I,
)
_MODULE = re.compile(r"\b(END)?(MODULE)\b", re.I)
_ROUTINE = re.compile(r"\b(END)?(PROC|FUNC|TRAP)\b", re.I)
_MOVE = re.compile(r"\b(Move(?:Abs)?(?:J|L|C)(?:DO|AO|GO|Sync)?|Trigg(?:J|L|C)|Search(?:L|C))\b\s*", re.I)
_ASSIGNED = re.compile(r"(?:^|;|:(?!=)|\bTHEN\b|\bDO\b|\bELSE\b)[ \t]*+(\w++)[ \t]*+(?:\{[^{};]*\}|\.[ \t]*\w++)*+\s*+:=", re.M | re.I)
_GIVEN = re.compile(r"(?:^|;|:(?!=)|\bTHEN\b|\bDO\b|\bELSE\b)[ \t]*+(\w++|%[^%;\n]*+%)(?=[ \t]++(?!:=))", re.M | re.I)
_CALLED = re.compile(r"(?<!\w)(?<!FUNC )(\w++)\s*+\(([^()]*+)\)", re.I)
_KINDS = r"(?:robtarget|jointtarget|tooldata|wobjdata)"
_ARGUMENTS = re.compile(r"\b(?:PROC|FUNC\s+\w+)\s+(\w+)\s*\(([^()]*+)\)", re.I)
_OWN = re.compile(rf"\b(?:VAR|PERS)\s+{_KINDS}\s+(\w+)\s*;", re.I)
_DISPLACED = re.compile(r"\b(PDispOn|PDispSet|EOffsOn|EOffsSet)\b", re.I)
_WORDS = re.compile(
    r"const|pers|var|local|task|sysmodule|(end)?(module|proc|func|trap|record)|alias|return|raise|exit|retry|trynext|(else|end)?if|else|(end)?(for|while|test)"
    r"|case|default|error|undo|backward|goto"
)
UNUSED = 9e8
"""An external axis that is not there is at 9E9."""


def read(sources: Sequence[Source]) -> Listing:
    """The targets of a program's modules together."""
    return _Reader(sources).listing()


class _Reader(Reader):
    def __init__(self, sources: Sequence[Source]) -> None:
        super().__init__(sources, "!", '"', ("wobj0", "tool0"))
        self.points = Points()
        self.moving: dict[str, str] = {}
        self.hidden = [self._hidden(k) for k in range(len(sources))]
        self.loose = any(re.search(r"\bConf[JL]\s*\\\s*Off\b", text, re.I) for text in self.plain)
        self.stated: set[str] = set()
        self.functions = {m[1].lower() for text in self.plain for m in re.finditer(r"\bFUNC\s+\w+\s+(\w+)", text, re.I)}
        self.displacement = self._displacement()

    def listing(self) -> Listing:
        for k, text in enumerate(self.plain):
            for m in _DECLARED.finditer(text):
                self._declared(k, m)
        for k, text in enumerate(self.plain):
            self._changed(k, text)
        for k, text in enumerate(self.plain):
            moves = list(_MOVE.finditer(text))
            for m, after in zip_longest(moves, moves[1:]):
                self._moved(k, m, after.start() if after else len(text))
        for point in self.points:
            k, name, used = point.source, point.name, point.used
            if not used:
                self.leave(k, point.span[0], message("robot_programs.no_motion_goes_stands", name=name))
            elif point.changed:
                self.leave(k, point.span[0], point.changed, name)
            elif len(used) > 1:
                self.leave_in_several(k, point.span[0], name, used)
            else:
                self._take(k, name, point.span, next(iter(used)), point.first or (k, point.span[0]))
        return super().listing()

    def _hidden(self, k: int) -> set[tuple[str, Span | None]]:
        """Names that a routine is given, or has without a value, and the routines in which they hide those of the module."""
        text = self.plain[k]
        out = {(m[1].lower(), _around(text, _ROUTINE, m.start())) for m in _OWN.finditer(text)}
        for m in _ARGUMENTS.finditer(text):
            block = _around(text, _ROUTINE, m.start())
            out |= {(name.lower(), block) for name in re.findall(rf"\b{_KINDS}\s+(\w+)", m[2], re.I)}
        return out

    def _hides(self, k: int, name: str, place: int) -> bool:
        block = _around(self.plain[k], _ROUTINE, place)
        return block is not None and (name.lower(), block) in self.hidden[k]

    def _frame_at(self, k: int, name: str, place: int) -> str:
        """Return the name of a frame; a parameter of a routine has an unstated one."""
        return message("robot_programs.given_to_routine", name=name, line=self.line(k, place)) if self._hides(k, name, place) else name

    def _changed(self, k: int, text: str) -> None:
        """Record variables that the program changes: they are no constants. Motions of a routine to its parameters are not determined, and
        all targets are elsewhere while a displacement may be on."""
        for m in _ASSIGNED.finditer(text):
            self._mark(k, m[1], m.start(1), message("robot_programs.changed_program_3"))
            if not self._hides(k, m[1], m.start(1)):
                self.moving.setdefault(m[1].lower(), self.where(k, m.start(1)))
        start = 0
        for end in (m.start() for m in re.finditer(";", text)):
            if (routine := _call(text, start, end)) is not None:
                for word in re.findall(r"\w+", text[routine.end() : end]):
                    self._mark(k, word, routine.start(1), message("program.passed", routine=routine[1]))
            start = end + 1
        for call in _CALLED.finditer(text):
            for word in re.findall(r"\w+", call[2]) if call[1].lower() in self.functions else ():
                self._mark(k, word, call.start(), message("program.passed", routine=call[1]))
        for point in self.points:
            if point.kind == "robtarget":
                point.changes(self.displacement)

    def _displacement(self) -> str:
        for k, text in enumerate(self.plain):
            m = _DISPLACED.search(text)
            if m:
                return message("robot_programs.displacement_may", m=m[1], name=self.sources[k].name, line=self.line(k, m.start()))
        return ""

    def _mark(self, k: int, name: str, place: int, why: str) -> None:
        point = None if self._hides(k, name, place) else self.points.at(name, k, place)
        if point is not None:
            point.changes(message("program.why_in", why=why, file=self.sources[k].name, line=self.line(k, place)))

    def _declared(self, k: int, m: re.Match[str]) -> None:
        text, kind, name = self.plain[k], m[2].lower(), m[3]
        span = m.end(), closing(text, m.end(), "[]")
        if span[1] < 0:
            self.leave(k, m.start(), message("program.not_closed", name=name))
        elif m[4]:
            self.leave(k, m.start(), message("program.array", name=name, kind=kind))
        elif kind in ("robtarget", "jointtarget"):
            self.points.add(Point(name, k, kind, span, self._region(k, m)))
        else:
            self._stated(k, kind, name, span)

    def _region(self, k: int, m: re.Match[str]) -> Region:
        """Return the region of a declaration: its routine, or for a local one its module, or everywhere."""
        around = [_ROUTINE, _MODULE] if "LOCAL" in m[1].upper() else [_ROUTINE]
        block = next((b for kind in around if (b := _around(self.plain[k], kind, m.start()))), None)
        return ((k, *block),) if block else EVERYWHERE

    def _stated(self, k: int, kind: str, name: str, span: Span) -> None:
        """A tool or a work object; where it cannot be read, moves, or is stated twice, targets in it are left for want of it."""
        text = self.plain[k]
        parts = pieces(text, (span[0] + 1, span[1]))
        words = [text[slice(*p)].upper() for p in parts]
        if kind == "tooldata":
            held, frames = words[:1] == ["TRUE"], parts[1:2]
        else:
            held, frames = words[:2] == ["FALSE", "TRUE"], parts[3:5]
        found = [self._frame(k, p) for p in frames]
        if not held:
            self.leave(k, span[0], message("program.tool_still" if kind == "tooldata" else "program.object_moves", name=name))
        elif not found or any(f is None for f in found):
            self.leave(k, span[0], message("program.no_frame", name=name))
        elif name.lower() in self.stated:
            self.leave(k, span[0], message("robot_programs.declared_more_than_once", name=name))
            self.frames.pop(name.lower(), None)
        else:
            total = np.array(IDENTITY)
            for one in found:
                assert one is not None
                total = se3.compose(total, one)
            self.frames[name.lower()] = total
        self.stated.add(name.lower())

    def _frame(self, k: int, span: Span) -> FloatArray | None:
        lists = self._lists(k, span)
        if lists is None or [len(v) for v in lists[:2]] != [3, 4]:
            return None
        values = [v for part in lists[:2] for v, _ in part]
        return None if wrong(values, values[3:]) else _pose(values)

    def _moved(self, k: int, m: re.Match[str], behind: int) -> None:
        text, move = self.plain[k], m[1].lower()
        end = text.find(";", m.end(), behind)
        if end < 0:
            self.leave(k, m.start(), message("program.open_instruction", name=m[1]))
            return
        plain = [p for p in pieces(text, (m.end(), end)) if text[p[0] : p[1]] and text[p[0]] != "\\"]
        if move.startswith("search"):
            # a signal and the target for the found position precede the target of the motion
            for start, stop in plain[:2]:
                self._mark(k, text[start:stop], start, message("program.searched"))
            plain = plain[2:]
        targets = plain[: 2 if move.startswith(("movec", "triggc", "searchc")) else 1]
        # to, speed, (trigger,) (zone,) tool; signals follow the tool
        tool = len(targets) + (1 if move.startswith("search") else 3 if move.startswith("trigg") else 2)
        word = re.match(r"\w+", text[slice(*plain[tool])]) if len(plain) > tool else None
        wobj = re.search(r"\\\s*WObj\s*:=\s*(\w+)(\s*\{)?", text[m.end() : end], re.I)
        frames = (
            self._frame_at(k, wobj[1].lower() + (wobj[2] or "") if wobj else "wobj0", m.start()),
            self._frame_at(k, word[0].lower() if word else "", m.start()),
        )
        sensed = re.search(r"\\\s*Corr\b", text[m.end() : end], re.I) is not None
        for start, stop in targets:
            line = f"{m[1]} of line {self.line(k, start)}"
            operand = re.sub(r"(?<=[\w\]])\s*\\.*", "", text[start:stop], flags=re.S).strip()
            point = None if self._hides(k, operand, start) else self.points.at(operand, k, start)
            if sensed:
                why: str = message("program.sensor", move=m[1])
                self.leave(k, start, why)
                if point is not None:
                    point.changes(message("program.moved_by", why=why))
            elif operand.startswith("[") and (why := self.displacement):
                self.leave(k, start, why, line)
            elif operand.startswith("["):
                self._take(k, line, (start, start + len(operand) - 1), frames, (k, start))
            elif point is not None:
                point.use({("wobj0", "tool0") if move.startswith("moveabs") else frames}, (k, start))
            elif re.fullmatch(r"\w+", operand):
                self.leave(k, start, message("robot_programs.not_declared_here_values_2", m=m[1], operand=operand))
            else:
                self.leave(k, start, message("robot_programs.target_computed_2", m=m[1], v2=text[start:stop]))

    def _take(self, k: int, name: str, span: Span, frames: tuple[str, str], moved: tuple[int, int]) -> None:
        lists = self._lists(k, span)
        if lists is None:
            self.leave(k, span[0], message("program.no_numbers", name=name))
            return
        place, shape = self.line(k, span[0]), [len(v) for v in lists]
        own = [v for part in lists[:-1] for v, _ in part]
        out = [v for v, _ in lists[-1] if v and abs(v) < UNUSED] if lists else []
        if shape == [6, 6]:
            numbers, spans = zip(*lists[0], strict=True)
            if why := wrong(own):
                self.leave(k, span[0], why, name)
            else:
                self.targets.append(Target(name, k, place, True, numbers, spans, *frames, moved=moved))
        elif shape != [3, 4, 4, 6]:
            self.leave(k, span[0], message("robot_programs.neither_robtarget_nor_jointtarget", name=name))
        elif why := wrong(own, own[3:7]):
            self.leave(k, span[0], why, name)
        elif frame := next((f for f in frames if f in self.moving), ""):
            self.leave(k, span[0], message("robot_programs.frame_set_program", name=name, frame=frame, where=self.moving[frame]))
        elif out:
            self.leave(k, span[0], message("robot_programs.external_axis_where_robot", name=name, value=out[0]))
        else:
            numbers, spans = zip(*lists[0], *lists[1], strict=True)
            flags = dict(zip(("cf1", "cf4", "cf6", "cfx"), (int(v) for v, _ in lists[2]), strict=True))
            self.targets.append(Target(name, k, place, False, numbers, spans, *frames, flags, moved, loose=self.loose))

    def _lists(self, k: int, span: Span) -> list[list[tuple[float, Span]]] | None:
        """Return lists of numbers within a list, with their places; None for any other content."""
        text = self.plain[k]
        out = []
        for start, stop in pieces(text, (span[0] + 1, closing(text, span[0], "[]"))):
            if not text[start:stop].startswith("[") or closing(text, start, "[]") != stop - 1:
                return None
            inner = []
            for part in pieces(text, (start + 1, stop - 1)):
                if not re.fullmatch(NUMBER, text[slice(*part)]):
                    return None
                inner.append((float(text[slice(*part)]), part))
            out.append(inner)
        return out


def _call(text: str, start: int, end: int) -> re.Match[str] | None:
    """Return the first word of a statement that calls a routine, or None. A call under a condition is a statement of its own behind
    THEN."""
    then = max((m.start() for m in re.finditer(rf"\bTHEN\b|{_MOVE.pattern}", text[start:end], re.I)), default=-1)
    for m in _GIVEN.finditer(text, start, end):
        at_once = m[1].upper() == "IF" and m.end() > start + then
        if at_once or not (_MOVE.match(m[1]) or _WORDS.fullmatch(m[1].lower())):
            return m
    return None


@lru_cache(maxsize=64)
def _blocks(text: str, marks: re.Pattern[str]) -> list[Span]:
    """Return where blocks begin and end, in order: each at the next end of its kind."""
    found, out, at = list(marks.finditer(text)), list[Span](), 0
    ends = {word: [m.end() for m in found if m[1] and m[2].upper() == word] for word in {m[2].upper() for m in found}}
    for m in found:
        own = ends[m[2].upper()]
        i = bisect_right(own, m.start())
        if not m[1] and m.start() >= at and i < len(own):
            at = own[i]
            out.append((m.start(), at))
    return out


def _around(text: str, marks: re.Pattern[str], place: int) -> Span | None:
    """Return the block around a place, or None."""
    blocks = _blocks(text, marks)
    i = bisect_right(blocks, (place, len(text))) - 1
    return blocks[i] if i >= 0 and place < blocks[i][1] else None


_pose, _numbers = of_quaternion((1, 2, 3, 0))


def _configured(flags: Mapping[str, int], degrees: FloatArray, arm: tuple[bool, bool] | None, slack_deg: float) -> bool:
    """Compare cf1, cf4 and cf6, the quarters of axes 1, 4 and 6, floor(q / 90 degrees), and cfx: 4 and more behind the first axis, odd
    where axis 5 is negative."""
    if "cf1" not in flags:
        return True
    quarters = all(
        int(np.floor(degrees[i] / 90.0)) == flags[key] or _at_quarter(degrees[i], slack_deg)
        for key, i in (("cf1", 0), ("cf4", 3), ("cf6", 5))
    )
    wrist = bool(flags["cfx"] & 1) == bool(degrees[4] < 0.0) or abs(degrees[4]) < slack_deg
    return quarters and (arm is None or ((flags["cfx"] >= 4) == arm[0] and wrist))


def _at_quarter(degrees: float, slack_deg: float) -> bool:
    return abs(degrees - 90.0 * round(degrees / 90.0)) < slack_deg


DIALECT = Dialect(
    "rapid", read, _pose, _numbers, math.radians(1.0), (4, 9, 5), suffixes=(".mod", ".modx", ".prg", ".sys"), configured=_configured
)
