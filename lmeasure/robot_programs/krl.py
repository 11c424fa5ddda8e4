"""KUKA KRL (.src, .dat): E6POS, POS, FRAME and E6AXIS, AXIS with BASE and TOOL; S and T are read, not changed.

Read: declared points and aggregates in PTP, LIN, CIRC and their S-kinds; $BASE, $TOOL set to BASE_DATA[n], TOOL_DATA[n], $NULLFRAME or an
aggregate, by a statement or by WITH for one motion or spline; BAS(#BASE, n), BAS(#TOOL, n); FDAT of inline forms. X.. in mm and A, B, C in
degrees: R = Rz(A) Ry(B) Rx(C). A .src and the .dat of its name are one module. Poses with external axes elsewhere than at 0 are left.
"""

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.robot_programs import frame_flow as krl_flow
from lmeasure.robot_programs.frame_flow import FIXED, NULL, Motion, fdat_frames
from lmeasure.robot_programs.program import (
    EVERYWHERE,
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
    Unread,
    closing,
    of_angles,
    pieces,
    wrong,
)
from lmeasure.text import message

POSE, AXES, EXTERNAL = ("X", "Y", "Z", "A", "B", "C"), tuple(f"A{i}" for i in range(1, 7)), tuple(f"E{i}" for i in range(1, 7))
FLAGS = "S", "T"
_DECLARED = re.compile(
    r"^[ \t]*((?:(?:GLOBAL|DECL|CONST)[ \t]++)*+)(E6POS|POS|FRAME|E6AXIS|AXIS|FDAT)[ \t]++(\$?\w++)\s*+=\s*+(?=\{)", re.I | re.M
)
_DATA = re.compile(r"\b((?:BASE|TOOL)_DATA)\s*\[\s*(\d{1,9})\s*\]\s*=\s*(?=\{)", re.I)
_ASSIGNED = re.compile(r"^[ \t]*(\w++(?:[ \t]*\[[^\]\n]*\])?)[ \t]*+(\.[ \t]*\w++[ \t]*+)?=(?!=)", re.M)
_FIELD = re.compile(rf"([A-Z]\w*+)\s++(?:({NUMBER})|'([BH])\s*([\dA-F]{{1,200}}+)')", re.I)
_FRAME_SET = re.compile(r"(?:.*\bWITH\s+)?\$(BASE|TOOL)\s*+=\s*+(.*?)(?:(?<!\s)\s+C_\w+)?", re.I | re.S)
_OF_FDAT = re.compile(r"S(?:BASE|TOOL2?)\((\w+)(?:\.\w+)?\)")
_pose, _numbers = of_angles("kuka-abc")


def read(sources: Sequence[Source]) -> Listing:
    """The targets of a program's files together: points of a .dat are given in the frames that the .src moves to them with."""
    return _Reader(sources).listing()


class _Reader(Reader):
    def __init__(self, sources: Sequence[Source]) -> None:
        super().__init__(sources, ";", '"', [NULL])
        self.modules = [s.name.rpartition(".")[0].upper() for s in sources]
        self.points = Points()
        self.fdat: dict[tuple[str, str], tuple[str, str]] = {}
        self.moving: dict[str, str] = {}
        self.reported: dict[str, list[tuple[int, int, FloatArray | None]]] = {}
        self.elsewhere, self.without = False, set[int]()

    def listing(self) -> Listing:
        for k in range(len(self.sources)):
            self._declared(k)
        self._stated()
        for k in range(len(self.sources)):
            self._assigned(k)
        for motion in krl_flow.motions(self.plain, self.modules, self._frame, self._of_fdat):
            self._move(motion)
        for k, text in enumerate(self.plain):
            for call, place, given in krl_flow.calls(text):
                self._passed(k, call, place, given)
        for point in self.points:
            self._point(point)
        for i in sorted(self.without, reverse=True) if self.elsewhere else ():
            lost = self.targets.pop(i)
            why = message("robot_programs.external_axes_not_stated", name=lost.name)
            self.unread.append(Unread(self.sources[lost.source].name, lost.line, why))
        return super().listing()

    def _region(self, k: int, words: str) -> Region:
        if "GLOBAL" in words.upper() or self.modules[k] == "$CONFIG":
            return EVERYWHERE
        return tuple((i, 0, len(t)) for i, t in enumerate(self.plain) if self.modules[i] == self.modules[k])

    def _declared(self, k: int) -> None:
        text = self.plain[k]
        for m in _DECLARED.finditer(text):
            span, kind, name = (m.end(), closing(text, m.end(), "{}")), m[2].upper(), m[3]
            if span[1] < 0:
                self.leave(k, m.start(2), message("program.aggregate_open", name=name))
            elif kind == "FDAT":
                self.fdat[self.modules[k], name.upper()] = fdat_frames(text[slice(*span)])
            elif kind == "FRAME":
                self.reported.setdefault(name.upper(), []).append((k, span[0], self._frame_of(k, span)))
            else:
                self.points.add(Point(name.upper(), k, kind, span, self._region(k, m[1])))
        for m in _DATA.finditer(text):
            name, span = f"{m[1].upper()}[{int(m[2])}]", (m.end(), closing(text, m.end(), "{}"))
            self.reported.setdefault(name, []).append((k, m.start(), self._frame_of(k, span)))

    def _stated(self) -> None:
        """Frames that the program has one value for."""
        for name, every in self.reported.items():
            k, place, first = every[0]
            if first is not None and all(f is not None and np.allclose(f, first, atol=1e-12) for _, _, f in every):
                self.frames[name] = first
            else:
                self.leave(k, place, message("program.frame_elsewhere", name=name))

    def _frame_of(self, k: int, span: Span) -> FloatArray | None:
        found = self._aggregate(k, span) if span[1] > 0 else None
        whole = found is not None and tuple(found) == POSE and not wrong([v for v, _ in found.values()])
        return _pose([v for v, _ in found.values()]) if found is not None and whole else None

    def _of_fdat(self, k: int, name: str) -> tuple[str, str] | None:
        return self.fdat.get((self.modules[k], name.upper()))

    def _assigned(self, k: int) -> None:
        """Record variables that the program changes: they are no constants."""
        text = self.plain[k]
        for m in _ASSIGNED.finditer(text):
            name, where = re.sub(r"\s", "", m[1]).upper(), self.where(k, m.start(1))
            point = self.points.at(name, k, m.start())
            if point is not None:
                point.changes(message("robot_programs.changed_program", where=where))
            if m[2] or not text[m.end() :].lstrip(" \t").startswith("{") or not re.search(r"\[\d+\]$", name):
                self.moving.setdefault(re.sub(r"\[(?!\d+\]).*", "", name), where)
                self.fdat.pop((self.modules[k], name), None)

    def _passed(self, k: int, call: str, place: int, given: str) -> None:
        """Points that a subroutine is given: where it moves to them is not determined."""
        for word in re.findall(r"\w+", given):
            point = self.points.at(word, k, place)
            if point is not None:
                point.changes(message("robot_programs.passed", call=call, name=self.sources[k].name, line=self.line(k, place)))

    def _frame(self, k: int, which: str, span: Span) -> str:
        """The name of a frame that $BASE or $TOOL is set to; an aggregate gets its own."""
        text = self.plain[k]
        value = text[slice(*span)].strip().upper().replace(" ", "")
        numbered = re.fullmatch(r"(BASE|TOOL)_DATA\[(\d+)\]", value)
        if numbered:
            return krl_flow.numbered(numbered[1], numbered[2])
        if value.startswith("{"):
            start = text.index("{", span[0])
            end = closing(text, start, "{}")
            frame = self._frame_of(k, (start, end)) if not text[end + 1 : span[1]].strip() else None
            if frame is not None:
                name = f"${which} of line {self.line(k, start)}"
                self.frames[name] = frame
                return name
        return value

    def _move(self, motion: Motion) -> None:
        k, kind, text = motion.source, motion.kind, self.plain[motion.source]
        if kind.endswith("_REL"):
            self.leave(k, motion.place, message("program.difference", name=kind))
            return
        if not motion.states:
            self.leave(k, motion.place, message("robot_programs.nothing_leads", name=kind))
            return
        parts = pieces(text, motion.rest)
        for start, stop in parts[: 2 if kind.endswith("CIRC") else 1]:
            operand = text[start:stop]
            word = re.match(r"\w+", operand)
            name = word[0].upper() if word else ""
            own = self._of_fdat(k, f"F{name[1:]}") if name.startswith("X") and motion.states == {("$BASE", "$TOOL")} else None
            frames = self._with(k, [*motion.spline, *parts], {own} if own else {(base, tool) for base, tool in motion.states})
            end = closing(text, start, "{}") if operand.startswith("{") else -1
            if end > 0 and not text[end + 1 : stop].lstrip().startswith(":"):
                self._take(f"{kind} of line {self.line(k, start)}", k, (start, end), frames, (k, start))
                continue
            point = self.points.at(name, k, start)
            if operand.startswith("{") and end < 0:
                self.leave(k, start, message("program.aggregate_open", name=kind))
            elif word is None or re.match(r"\s*[:\[.]", operand[word.end() :]):
                self.leave(k, start, message("robot_programs.target_computed", kind=kind, strip=operand.strip()))
            elif point is None:
                self.leave(k, start, message("robot_programs.not_declared_here_values", kind=kind, name=name))
            else:
                point.use(frames, (k, start))

    def _with(self, k: int, parts: Sequence[Span], frames: set[tuple[str, str]]) -> set[tuple[str, str]]:
        """Frames that a motion has of its own, or of its spline: WITH $BASE = ..., $TOOL = ..."""
        for start, stop in parts:
            m = _FRAME_SET.fullmatch(self.plain[k], start, stop)
            if m is None:
                continue
            of = _OF_FDAT.fullmatch(m[2].upper().replace(" ", ""))
            both = self._of_fdat(k, of[1]) if of else None
            if both == FIXED:
                return {both}
            name = both[m[1].upper() == "TOOL"] if both else self._frame(k, m[1].upper(), m.span(2))
            frames = {(name, t) if m[1].upper() == "BASE" else (b, name) for b, t in frames}
        return frames

    def _point(self, point: Point) -> None:
        own = self._of_fdat(point.source, f"F{point.name[1:]}") if point.name.startswith("X") else None
        used = point.used or ({own} if own else set())
        if not used and point.kind.endswith("AXIS"):
            used = {(NULL, NULL)}
        if not used:
            self.leave(point.source, point.span[0], message("robot_programs.no_motion_here_so", name=point.name))
        elif point.changed:
            self.leave(point.source, point.span[0], point.changed, point.name)
        else:
            self._take(point.name, point.source, point.span, used, point.first or (point.source, point.span[0]))

    def _take(self, name: str, k: int, span: Span, used: set[tuple[str, str]], moved: tuple[int, int]) -> None:
        found = self._aggregate(k, span)
        if found is None:
            self.leave(k, span[0], message("program.aggregate_field", name=name))
            return
        joints = "A1" in found
        wanted = AXES if joints else POSE
        missing = [key for key in wanted if key not in found]
        out = {key: found[key][0] for key in EXTERNAL if key in found}
        self.elsewhere |= any(out.values())
        frames = min(used)
        if missing:
            self.leave(k, span[0], message("program.rest", name=name, missing=tuple(missing)))
        elif why := wrong([v for v, _ in found.values()]):
            self.leave(k, span[0], why, name)
        elif not joints and any(out.values()):
            key = next(key for key in out if out[key])
            self.leave(k, span[0], message("robot_programs.where_robot_workpiece_then_not", name=name, axis=key, value=out[key]))
        elif len(used) > 1 and not joints:
            self.leave_in_several(k, span[0], name, used)
        elif not joints and (frame := next((f for f in frames if self._set_at(f)), "")):
            self.leave(k, span[0], message("robot_programs.frame_set_program", name=name, frame=frame, where=self._set_at(frame)))
        elif frames[0] == FIXED[0]:
            self.leave(k, span[0], message("robot_programs.robot_holds_workpiece_tool", name=name))
        else:
            flags = {key: int(found[key][0]) for key in FLAGS if key in found}
            if not joints and not out:
                self.without.add(len(self.targets))
            values, spans = zip(*(found[key] for key in wanted), strict=True)
            self.targets.append(Target(name, k, self.line(k, span[0]), joints, values, spans, *frames, flags, moved))

    def _set_at(self, frame: str) -> str:
        """Return where the program changes a frame, itself or with others of its array; empty if it does not."""
        return self.moving.get(frame) or self.moving.get(frame.partition("[")[0], "")

    def _aggregate(self, k: int, span: Span) -> dict[str, tuple[float, Span]] | None:
        """Return fields of {E6POS: X 1.0, Y ...} with their places; None if one is no number, or occurs twice."""
        text = self.plain[k]
        if span[1] < 0:
            return None
        start = span[0] + 1
        typed = re.compile(r"\s*\w+\s*:").match(text, start, span[1])
        out: dict[str, tuple[float, Span]] = {}
        for part in pieces(text, (typed.end() if typed else start, span[1])):
            m = _FIELD.fullmatch(text, *part)
            if m is None or m[1].upper() in out or (m[3] and m[1].upper() not in FLAGS):
                return None
            value = float(m[2]) if m[2] else _whole(m[4], 2 if m[3].upper() == "B" else 16)
            if value is None:
                return None
            out[m[1].upper()] = (value, m.span(2 if m[2] else 4))
        return out


def _whole(digits: str, base: int) -> float | None:
    try:
        return float(int(digits, base))
    except ValueError:
        return None


def _configured(flags: Mapping[str, int], degrees: FloatArray, arm: tuple[bool, bool] | None, slack_deg: float) -> bool:
    """Compare S and T: bit i of T is set where axis i + 1 is negative; bit 0 of S behind the first axis, bit 1 with the elbow up."""
    if not set(FLAGS) <= set(flags):
        return True
    turned = all(bool(flags["T"] >> i & 1) == bool(degrees[i] < 0.0) or abs(degrees[i]) < slack_deg for i in range(6))
    return turned and (arm is None or (bool(flags["S"] & 1), bool(flags["S"] & 2)) == arm)


DIALECT = Dialect("krl", read, _pose, _numbers, math.radians(1.0), (4, 5, 5), suffixes=(".src", ".dat"), configured=_configured)
