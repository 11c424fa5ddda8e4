"""Universal Robots script: p[...] poses (m, rotation vector) and [...] joint values (rad) of movej, movel, movep, movec, servoj; set_tcp.

Read: literals in the call, or names that are set to one literal. The tool is what the last set_tcp before the line sets, else `tcp`, the
controller's own, which the user has to state; a base is `base`, or the frame that pose_trans(frame, p[...]) names.
"""

import re
from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure import se3
from lmeasure.arrays import FloatArray
from lmeasure.robots.dialects.frame_flow import Event, State, states
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
    numbers_in,
    pieces,
)
from lmeasure.robots.dialects.program_text import pose as _placed

_SET = re.compile(r"^[ \t]*(?:global\s+|local\s+)?(\w+)\s*=\s*(p?)(?=\[)", re.M)
_ASSIGNED = re.compile(r"^[ \t]*(?:global\s+|local\s+)?(\w+)\s*(?:\[[^\]]*\]\s*)?=(?!=)", re.M)
_BLOCK = re.compile(r"^[ \t]*(?:(?:def|thread)\s+(?P<def>\w+)|(?P<block>if|elif|else|while|end)\b|(?P<call>\w+)\s*\(\s*\))", re.M)
_CALL = re.compile(r"\b(set_tcp|movej|movel|movep|movec|servoj)\s*(?=\()")
_TRANS = re.compile(r"pose_trans\s*(?=\()")


def read(sources: Sequence[Source]) -> Listing:
    """The targets of scripts, each for itself."""
    targets: list[Target] = []
    unread: list[Unread] = []
    frames = {"base": np.array(IDENTITY)}
    for k, source in enumerate(sources):
        _Reader(k, source, targets, unread, frames=frames).read()
    return Listing(tuple(sources), tuple(targets), frames, tuple(unread))


class _Reader:
    def __init__(self, k: int, source: Source, targets: list[Target], unread: list[Unread], *, frames: dict[str, FloatArray]) -> None:
        self.k, self.source, self.targets, self.unread, self.frames = k, source, targets, unread, frames
        self.text = masked(source.text, "#", "\"'")
        self.named: dict[str, tuple[bool, Span]] = {}
        self.used: dict[str, set[tuple[str, str]]] = {}
        self.first: dict[str, int] = {}

    def read(self) -> None:
        text = self.text
        often = [m[1] for m in _ASSIGNED.finditer(text)]
        for m in _SET.finditer(text):
            end = closing(text, m.end(), "[]")
            if end > 0 and often.count(m[1]) == 1:
                self.named[m[1]] = (m[2] == "p", (m.end(), end + 1))
        events, moves = self._blocks(), dict[int, tuple[str, list[Span]]]()
        for m in _CALL.finditer(text):
            end = closing(text, m.end(), "()")
            if end < 0:
                self._leave(m.start(), f"{m[1]}: a call that is not closed")
                continue
            arguments = pieces(text, (m.end() + 1, end))
            if m[1] == "set_tcp":
                events.append(Event(m.start(), "set", change=partial(_told, (self._tool(arguments[0]),))))
            else:
                moves[m.start()] = m[1], arguments[: 2 if m[1] == "movec" else 1]
                events.append(Event(m.start(), "move"))
        for place, found in states(sorted(events, key=lambda e: e.place), ("tcp",)).items():
            for argument in moves[place][1]:
                self._moved(moves[place][0], argument, {state[0] for state in found})
        for name, used in self.used.items():
            is_pose, span = self.named[name]
            self._take(name, span, is_pose, used)
        for name, (_, span) in self.named.items():
            if name not in self.used and name not in self.frames and self._six(span) is not None:
                self._leave(span[0], f"{name}: no motion goes to it as it stands")

    def _blocks(self) -> list[Event]:
        """Functions, whose `end` is that of a block in which nothing is left beside it, and blocks."""
        events = []
        depth = 0
        for m in _BLOCK.finditer(self.text):
            place, word = m.start(), m["block"] or ""
            if m["def"]:
                depth, event = 0, Event(place, "begin", m["def"])
            elif word in ("if", "while"):
                depth, event = depth + 1, Event(place, "branch" if word == "if" else "loop")
            elif word in ("elif", "else"):
                event = Event(place, "else", whole=word == "else")
            elif word == "end":
                # that of a function ends it: what follows stands in none
                event = Event(place, "close") if depth else Event(place, "begin", "")
                depth = max(depth - 1, 0)
            else:
                event = Event(place, "call", m["call"])
            events.append(event)
        return events

    def _tool(self, argument: Span) -> str:
        """The name of the tool that a set_tcp sets; one that is computed is stated nowhere."""
        word = self.text[slice(*argument)]
        span = self.named[word][1] if word in self.named else (argument[0] + 1, argument[1])
        found = self._six(span) if word in self.named or word.startswith("p[") else None
        name = f"set_tcp of {self.source.name}:{self.source.line(argument[0])}"
        if found is not None:
            self.frames[name] = _pose([v for v, _ in found])
            if word in self.named:
                self.frames[word] = self.frames[name]
        return name

    def _moved(self, move: str, argument: Span, tools: set[str]) -> None:
        text = self.text
        operand, base = text[slice(*argument)], "base"
        trans = _TRANS.match(operand)
        if trans:
            start = argument[0] + trans.end()
            parts = pieces(text, (start + 1, closing(text, start, "()")))
            if len(parts) != 2 or not re.fullmatch(r"\w+", text[slice(*parts[0])]):
                self._leave(argument[0], f"{move} {operand}: a target that is computed")
                return
            base, argument = text[slice(*parts[0])], parts[1]
            operand = text[slice(*argument)]
            if base in self.named and self.named[base][0]:
                found = self._six(self.named[base][1])
                if found is not None:
                    self.frames[base] = _pose([v for v, _ in found])
        line = f"{move} of line {self.source.line(argument[0])}"
        frames = {(base, tool) for tool in tools}
        if operand.startswith("p["):
            self._take(line, (argument[0] + 1, argument[1]), True, frames)
        elif operand.startswith("["):
            self._take(line, argument, False, frames)
        elif operand in self.named:
            self.used.setdefault(operand, set()).update(frames)
            self.first.setdefault(operand, argument[0])
        else:
            self._leave(argument[0], f"{move} {operand}: a target that is computed or set elsewhere")

    def _take(self, name: str, span: Span, is_pose: bool, used: set[tuple[str, str]]) -> None:
        if len(used) > 1 and is_pose:
            self._leave(span[0], f"{name}: moved to in several frames: {', '.join(sorted(' / '.join(u) for u in used))}")
            return
        frames, found = min(used), self._six(span)
        if found is None:
            self._leave(span[0], f"{name}: not six numbers")
            return
        values, spans = zip(*found, strict=True)
        moved = self.k, self.first.get(name, span[0])
        self.targets.append(Target(name, self.k, self.source.line(span[0]), not is_pose, values, spans, *frames, moved=moved))

    def _six(self, span: Span) -> list[tuple[float, Span]] | None:
        """The six numbers of a list in brackets, with their places; None where anything else stands there."""
        parts = pieces(self.text, (span[0] + 1, span[1] - 1))
        plain = all(re.fullmatch(NUMBER, self.text[slice(*p)]) for p in parts)
        return numbers_in(self.text, (span[0] + 1, span[1] - 1)) if plain and len(parts) == 6 else None

    def _leave(self, place: int, why: str) -> None:
        self.unread.append(Unread(self.source.name, self.source.line(place), why))


def _told(tool: State, _: State) -> State:
    return tool


def _pose(values: Sequence[float]) -> FloatArray:
    return _placed([1000.0 * v for v in values[:3]], Rotation.from_rotvec(np.asarray(values[3:6], dtype=np.float64)))


def _numbers(row: FloatArray, old: Sequence[float]) -> FloatArray:
    vector = se3.rotation(row).as_rotvec()
    before, angle = np.asarray(old[3:6], dtype=np.float64), float(np.linalg.norm(vector))
    # the same rotation the other way about, or whole turns further, where the old one was written so
    if angle > 0.0:
        axis = vector / angle
        vector = axis * (angle + 2.0 * np.pi * np.round((before @ axis - angle) / (2.0 * np.pi)))
    return np.concatenate([row[:3] / 1000.0, vector])


DIALECT = Dialect("ur-script", read, _pose, _numbers, 1.0, (7, 7, 7), ("base",))
