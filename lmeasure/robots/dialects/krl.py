"""KUKA KRL (.src, .dat): E6POS, POS, FRAME and E6AXIS, AXIS with BASE and TOOL; S and T are read, not changed.

Read: declared points and aggregates in PTP, LIN, CIRC and their S-kinds; $BASE, $TOOL set to BASE_DATA[n], TOOL_DATA[n], $NULLFRAME or an
aggregate; BAS(#BASE, n), BAS(#TOOL, n); FDAT of inline forms. X.. in mm and A, B, C in degrees: R = Rz(A) Ry(B) Rx(C).
"""

import math
import re
from collections.abc import Callable, Sequence

import numpy as np

from lmeasure.arrays import FloatArray
from lmeasure.robots.dialects.euler import of_angles
from lmeasure.robots.dialects.frame_flow import Event, State, states
from lmeasure.robots.dialects.program_text import IDENTITY, NUMBER, Dialect, Listing, Source, Span, Target, Unread, closing, masked, pieces

NULL = "$NULLFRAME"
POSE, AXES = ("X", "Y", "Z", "A", "B", "C"), tuple(f"A{i}" for i in range(1, 7))
_DECLARED = re.compile(r"^[ \t]*(?:(?:GLOBAL|DECL|CONST)\s+)*(E6POS|POS|FRAME|E6AXIS|AXIS|FDAT)\s+(\$?\w+)\s*=\s*(?=\{)", re.I | re.M)
_DATA = re.compile(r"\b((?:BASE|TOOL)_DATA)\s*\[\s*(\d+)\s*\]\s*=\s*(?=\{)", re.I)
_STATEMENT = re.compile(
    r"^[ \t]*(?:(?P<move>S?(?:PTP|LIN|CIRC)(?:_REL)?|SPL)\b[ \t]*(?P<rest>.*)"
    r"|\$(?P<frame>BASE|TOOL)\s*(?:\.\s*\w+\s*=|=\s*(?P<value>.*))"
    r"|(?:GLOBAL\s+)?(?P<block>IF|ELSE|ENDIF|SWITCH|CASE|DEFAULT|ENDSWITCH|FOR|ENDFOR|WHILE|ENDWHILE|REPEAT|UNTIL|LOOP|ENDLOOP"
    r"|DEF|DEFFCT)\b(?:(?<=DEF)\s+(?P<def>\w+)|(?<=DEFFCT)\s+\w+\s+(?P<fct>\w+))?"
    r"|BAS\s*\(\s*#(?P<bas>BASE|TOOL)\s*,\s*(?P<number>\d+)\s*\)"
    r"|FDAT_ACT\s*=\s*(?P<fdat>\w+)"
    r"|(?P<call>[A-Z]\w*)\s*\((?P<given>.*)\))",
    re.I | re.M,
)
_ASSIGNED = re.compile(r"^[ \t]*(\w+(?:\s*\[\s*\d+\s*\])?)[ \t]*(\.[ \t]*\w+[ \t]*)?=(?!=)", re.M)
_FIELD = re.compile(rf"([A-Z]\w*)\s+({NUMBER})", re.I)
_pose, _numbers = of_angles("kuka-abc")


def read(sources: Sequence[Source]) -> Listing:
    """The targets of a program's files together: points of a .dat are told in the frames that the .src moves to them with."""
    return _Reader(sources).listing()


class _Reader:
    def __init__(self, sources: Sequence[Source]) -> None:
        self.sources = tuple(sources)
        self.plain = [masked(s.text, ";") for s in sources]
        self.points: dict[str, tuple[int, str, Span]] = {}
        self.fdat: dict[str, tuple[str, str]] = {}
        self.frames: dict[str, FloatArray] = {NULL: np.array(IDENTITY)}
        self.used: dict[str, set[tuple[str, str]]] = {}
        self.first: dict[str, tuple[int, int]] = {}
        self.changed: dict[str, str] = {}
        self.targets: list[Target] = []
        self.unread: list[Unread] = []

    def listing(self) -> Listing:
        for k in range(len(self.sources)):
            self._declared(k)
        for k in range(len(self.sources)):
            self._assigned(k)
        self._moved()
        for name, (k, kind, span) in self.points.items():
            self._point(name, k, kind, span)
        return Listing(self.sources, tuple(self.targets), self.frames, tuple(self.unread))

    def _declared(self, k: int) -> None:
        text = self.plain[k]
        for m in _DECLARED.finditer(text):
            span = m.end(), closing(text, m.end(), "{}")
            if span[1] < 0:
                self._leave(k, m.start(), f"{m[2]}: an aggregate that is not closed")
            elif m[1].upper() == "FDAT":
                numbers = dict(re.findall(r"(TOOL_NO|BASE_NO)\s+(\d+)", text[slice(*span)].upper()))
                at_tool = "#TCP" in text[slice(*span)].upper()
                tool, base = (numbers.get(f"{what}_NO") for what in ("TOOL", "BASE"))
                self.fdat[m[2].upper()] = ("fixed tool", "") if at_tool or tool is None or base is None else _frames(base, tool)
            elif m[1].upper() == "FRAME":
                found = self._aggregate(k, span)
                if found is not None and tuple(found) == POSE:
                    self.frames[m[2].upper()] = _pose([v for v, _ in found.values()])
            else:
                self.points[m[2].upper()] = (k, m[1].upper(), span)
        for m in _DATA.finditer(text):
            span = m.end(), closing(text, m.end(), "{}")
            found = self._aggregate(k, span) if span[1] > 0 else None
            if found is not None and tuple(found) == POSE:
                self.frames[f"{m[1].upper()}[{m[2]}]"] = _pose([v for v, _ in found.values()])

    def _moved(self) -> None:
        """All files together: subroutines of one are called in another."""
        events, moves, offset = [], dict[int, tuple[int, re.Match[str]]](), 0
        for k, text in enumerate(self.plain):
            events.append(Event(offset, "begin", f"file {k}"))
            for m in _STATEMENT.finditer(text):
                place = offset + m.start()
                if m["move"]:
                    moves[place] = (k, m)
                    events.append(Event(place, "move"))
                elif m["block"]:
                    events.append(_block(place, m["block"].upper(), m["def"] or m["fct"] or ""))
                elif m["call"]:
                    events.append(Event(place, "call", m["call"].upper()))
                    self._passed(k, m)
                else:
                    events.append(Event(place, "set", change=self._change(k, m)))
            offset += len(text) + 1
        for place, found in states(events, ("$BASE", "$TOOL")).items():
            self._move(*moves[place], {(base, tool) for base, tool in found})

    def _change(self, k: int, m: re.Match[str]) -> Callable[[State], State]:
        """What a statement does to base and tool."""
        if m["fdat"]:
            both = self.fdat.get(m["fdat"].upper(), ("$BASE", "$TOOL"))
            return lambda _: both
        if m["bas"]:
            which, name = m["bas"].upper(), f"{m['bas'].upper()}_DATA[{m['number']}]" if int(m["number"]) else NULL
        else:
            which = m["frame"].upper()
            name = self._frame(k, m) if m["value"] else f"${which} changed in line {self.sources[k].line(m.start('frame'))}"
        return (lambda s: (name, s[1])) if which == "BASE" else (lambda s: (s[0], name))

    def _passed(self, k: int, m: re.Match[str]) -> None:
        """Points that a subroutine is given: where it moves to them is not told."""
        for word in re.findall(r"\w+", m["given"]):
            if word.upper() in self.points:
                where = f"{self.sources[k].name}:{self.sources[k].line(m.start('call'))}"
                self.changed.setdefault(word.upper(), f"is passed to {m['call']} in {where}")

    def _assigned(self, k: int) -> None:
        """What the program changes while it runs is no constant."""
        for m in _ASSIGNED.finditer(self.plain[k]):
            name = re.sub(r"\s", "", m[1]).upper()
            if m[2] or name in self.points:
                where = f"{self.sources[k].name}:{self.sources[k].line(m.start(1))}"
                self.changed.setdefault(name, f"is changed by the program in {where}")
                self.frames.pop(name, None)

    def _frame(self, k: int, m: re.Match[str]) -> str:
        """The name of a frame that $BASE or $TOOL is set to; an aggregate gets its own."""
        value = m["value"].strip().upper().replace(" ", "")
        numbered = re.fullmatch(r"((?:BASE|TOOL)_DATA)\[(\d+)\]", value)
        if numbered:
            return f"{numbered[1]}[{int(numbered[2])}]" if int(numbered[2]) else NULL
        if value.startswith("{"):
            start = m.start("value")
            found = self._aggregate(k, (start, closing(self.plain[k], start, "{}")))
            if found is not None and tuple(found) == POSE:
                name = f"${m['frame'].upper()} of line {self.sources[k].line(start)}"
                self.frames[name] = _pose([v for v, _ in found.values()])
                return name
        return value

    def _move(self, k: int, m: re.Match[str], frames: set[tuple[str, str]]) -> None:
        text, kind = self.plain[k], m["move"].upper()
        if kind.endswith("_REL"):
            self._leave(k, m.start("move"), f"{kind}: moves by a difference, not to a target")
            return
        parts = pieces(text, (m.start("rest"), m.end("rest")))[: 2 if kind.endswith("CIRC") else 1]
        for start, stop in parts:
            operand = text[start:stop]
            if operand.startswith("{"):
                end = closing(text, start, "{}")
                self._take(k, f"{kind} of line {self.sources[k].line(start)}", (start, end), frames)
                continue
            word = re.match(r"\w+", operand)
            name = word[0].upper() if word else ""
            if word is None or re.match(r"\s*[:\[.]", operand[word.end() :]):
                self._leave(k, start, f"{kind} {operand.strip()}: a target that is computed")
            elif name in self.points:
                own = self.fdat.get(f"F{name[1:]}") if name.startswith("X") and frames == {("$BASE", "$TOOL")} else None
                self.used.setdefault(name, set()).update({own} if own else frames)
                self.first.setdefault(name, (k, start))
            else:
                self._leave(k, start, f"{kind} {name}: is not declared here")

    def _point(self, name: str, k: int, kind: str, span: Span) -> None:
        own = self.fdat.get(f"F{name[1:]}") if name.startswith("X") else None
        used = self.used.get(name) or ({own} if own else set())
        if not used and kind.endswith("AXIS"):
            used = {(NULL, NULL)}
        if not used:
            self._leave(k, span[0], f"{name}: no motion to it is here, so that its frames are not known")
        elif name in self.changed:
            self._leave(k, span[0], f"{name}: {self.changed[name]}")
        else:
            self._take(k, name, span, used)

    def _take(self, k: int, name: str, span: Span, used: set[tuple[str, str]]) -> None:
        found = self._aggregate(k, span)
        if found is None:
            self._leave(k, span[0], f"{name}: an aggregate with what is no number")
            return
        joints = "A1" in found
        wanted = AXES if joints else POSE
        if not all(key in found for key in wanted):
            self._leave(
                k, span[0], f"{name}: {', '.join(key for key in wanted if key not in found)} not stated: the rest is where the robot is"
            )
            return
        if len(used) > 1 and not joints:
            self._leave(k, span[0], f"{name}: moved to in several frames: {', '.join(sorted(' / '.join(u) for u in used))}")
            return
        frames = min(used)
        if frames[0] == "fixed tool":
            self._leave(k, span[0], f"{name}: the robot holds the workpiece, the tool stands still")
            return
        flags: dict[str, int] = {key: int(found[key][0]) for key in ("S", "T") if key in found}
        values, spans = zip(*(found[key] for key in wanted), strict=True)
        moved = self.first.get(name, (k, span[0]))
        self.targets.append(Target(name, k, self.sources[k].line(span[0]), joints, values, spans, *frames, flags, moved))

    def _aggregate(self, k: int, span: Span) -> dict[str, tuple[float, Span]] | None:
        """Fields of {E6POS: X 1.0, Y ...} with their places; None where one is no number."""
        text = self.plain[k]
        if span[1] < 0:
            return None
        start = span[0] + 1
        typed = re.compile(r"\s*\w+\s*:").match(text, start, span[1])
        out = {}
        for part in pieces(text, (typed.end() if typed else start, span[1])):
            m = _FIELD.fullmatch(text, *part)
            if m is None:
                return None
            out[m[1].upper()] = (float(m[2]), m.span(2))
        return out

    def _leave(self, k: int, place: int, why: str) -> None:
        self.unread.append(Unread(self.sources[k].name, self.sources[k].line(place), why))


def _frames(base: str, tool: str) -> tuple[str, str]:
    return (f"BASE_DATA[{int(base)}]" if int(base) else NULL), (f"TOOL_DATA[{int(tool)}]" if int(tool) else NULL)


def _block(place: int, word: str, name: str) -> Event:
    if word in ("DEF", "DEFFCT"):
        return Event(place, "begin", name.upper())
    if word in ("ELSE", "CASE", "DEFAULT"):
        return Event(place, "else", whole=word != "CASE")
    if word.startswith("END") or word == "UNTIL":
        return Event(place, "close")
    return Event(place, "branch" if word in ("IF", "SWITCH") else "loop")


DIALECT = Dialect("krl", read, _pose, _numbers, math.radians(1.0), (4, 5, 5), (NULL,))
