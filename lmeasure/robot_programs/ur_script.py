"""Universal Robots script: p[...] poses (m, rotation vector) and [...] joint values (rad) of movej, movel, movep, movec, servoj; set_tcp.

Read: literals in the call, or names that are set to one literal; a pose within get_inverse_kin(pose, qnear), whose joint values choose the
solution. The tool is that of the last set_tcp before the line, else `tcp`, the controller's own, which you must state; a base is `base`, or
the frame that pose_trans(frame, p[...]) names.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, se3
from lmeasure.robot_programs.frame_flow import Event, State, states
from lmeasure.robot_programs.program import NUMBER, Dialect, Listing, Reader, Source, Span, Target, closing, numbers_in, pieces, wrong
from lmeasure.text import composed, message

_SET = re.compile(r"^[ \t]*(?:global\s++|local\s++)?(\w++)\s*+=\s*+(p?)(?=\[)", re.M)
_ASSIGNED = re.compile(r"^[ \t]*(?:global\s++|local\s++)?(\w++)\s*+(?:\[[^\]\n]*+\]\s*+)?=(?!=)", re.M)
_BLOCK = re.compile(
    r"^[ \t]*(?:(?:def|thread|sec)\s+(?P<def>\w+)|(?P<block>if|elif|else|while)\b|(?P<leaves>break|continue|return|halt)\b)"
    r"|\b(?P<end>end)\b",
    re.M,
)
_DEFINED = re.compile(r"^[ \t]*(?:def|thread|sec)\s+(\w+)\s*\(([^()]*+)\)", re.M)
_CALL = re.compile(r"\b(set_tcp|movej|movel|movep|movec|servoj|servoc)\s*(?=\()")
_MOVED_ALONG = re.compile(
    r"\b(?:(track_conveyor_linear|track_conveyor_circular|path_offset_enable)|stop_conveyor_tracking|path_offset_disable)\s*\("
)
_CALLED = re.compile(r"(\b(?:def|thread|run)\s++)?\b(\w++)\s*+\(")
_ALONE = re.compile(r"[^\S\n]*+(?:\n|\Z)")
_TARGET_KEYS = "q", "pose", "pose_via", "pose_to"
_TRANS = re.compile(r"pose_trans\s*(?=\()")
_INVERSE = re.compile(r"get_inverse_kin\s*(?=\()")
_KEY = re.compile(r"(\w+)\s*=\s*")
_INVERSE_KEYS = "x", "qnear", "maxPositionError", "maxOrientationError", "tcp"


def read(sources: Sequence[Source]) -> Listing:
    """The targets of scripts, each for itself."""
    reader = Reader(sources, "#", "\"'", ["base"])
    for k in range(len(sources)):
        _Script(k, reader).read()
    return reader.listing()


@dataclass
class _Literal:
    """A name that is set to one list: whether it is a pose, where; the frames that it is moved to in, joint values stated beside it, the
    first motion, and why it is left."""

    is_pose: bool
    span: Span
    used: set[tuple[str, str]] = field(default_factory=set)
    near: set[tuple[float, ...]] = field(default_factory=set)
    first: int = -1
    changed: str = ""


class _Script:
    def __init__(self, k: int, reader: Reader) -> None:
        self.k, self.reader, self.source, self.frames, self.text = k, reader, reader.sources[k], reader.frames, reader.plain[k]
        self.named: dict[str, _Literal] = {}
        self.aside: set[str] = set()
        self.tools: dict[bytes, str] = {}
        self.passed = 0

    def read(self) -> None:
        text = self.text
        # names of a function's parameters
        taken = {name for m in _DEFINED.finditer(text) for name in re.findall(r"\w+", m[2])}
        often = Counter(m[1] for m in _ASSIGNED.finditer(text))
        for m in _SET.finditer(text):
            end = closing(text, m.end(), "[]")
            if end > 0 and _ALONE.match(text, end + 1) and often[m[1]] == 1 and m[1] not in taken:
                self.named[m[1]] = _Literal(m[2] == "p", (m.end(), end + 1))
        events, moves = self._blocks(), dict[int, tuple[str, list[Span]]]()
        within = 0
        for m in _CALL.finditer(text):
            if m.start() < within:
                continue  # in brackets of another: no motion
            within = end = closing(text, m.end(), "()")
            if end < 0:
                self.leave(m.start(), message("program.call_open", name=m[1]))
                continue
            arguments = [self._unnamed(part) for part in pieces(text, (m.end() + 1, end))]
            if m[1] == "set_tcp":
                events.append(Event(m.start(), "set", change=partial(_with_tool, (self._tool(arguments[0]),))))
            else:
                moves[m.start()] = m[1], arguments[: 2 if m[1] == "movec" else 1]
                events.append(Event(m.start(), "move"))
        for m in _MOVED_ALONG.finditer(text):
            along = message("robot_programs.of_line", name=m[1], line=self.source.line(m.start())) if m[1] else ""
            events.append(Event(m.start(), "set", change=partial(_along, along)))
        for place, found in states(sorted(events, key=lambda e: e.place), ("tcp", "")).items():
            move, arguments = moves[place]
            for argument in arguments:
                along = max((state[1] for state in found), default="")
                if along:
                    self.leave(
                        place,
                        composed(
                            "{move} {pose}: {why}", move=move, pose=text[slice(*argument)], why=message("program.moved_along", along=along)
                        ),
                    )
                    for name in re.findall(r"\w+", text[slice(*argument)]):
                        if name in self.named:
                            self.named[name].changed = message("program.moved_along", along=along)
                elif found:
                    self._moved(move, argument, {state[0] for state in found})
                else:
                    self.leave(place, message("robot_programs.nothing_leads_2", move=move, v2=text[slice(*argument)]))
                    self.aside.add(text[slice(*argument)])
        for name, literal in self.named.items():
            if literal.used:
                self._take(name, literal)
            elif name not in self.frames and name not in self.aside and self._six(literal.span) is not None:
                self.leave(literal.span[0], message("robot_programs.no_motion_goes_stands", name=name))

    def _blocks(self) -> list[Event]:
        """Return events of functions, which may be inside others, blocks, and calls of the functions; a started thread may or may not have
        run."""
        events = []
        inside: list[bool] = []  # of the `end`s to come: whether each is a function's
        for m in _BLOCK.finditer(self.text):
            place, word = m.start(), m["block"] or m["leaves"] or m["end"] or ""
            if m["def"]:
                inside.append(True)
                events.append(Event(place, "begin", m["def"]))
            elif word in ("if", "while"):
                inside.append(False)
                ever = re.match(r"\s*\(?\s*True\s*\)?\s*:", self.text[m.end() :][:40]) is not None
                events.append(Event(place, "branch") if word == "if" else Event(place, "loop", whole=ever))
            elif word in ("elif", "else"):
                events.append(Event(place, "else", whole=word == "else"))
            elif word == "end":
                events.append(Event(place, "finish" if inside and inside.pop() else "close"))
            else:
                events.append(Event(place, "exit" if word == "break" else "next" if word == "continue" else "return"))
        defined = {m[1] for m in _DEFINED.finditer(self.text)}
        for m in _CALLED.finditer(self.text):
            word, place = (m[1] or "").strip(), m.start(2)
            if m[2] not in defined:
                continue
            if word == "run":
                events += [Event(place, "branch"), Event(place, "call", m[2]), Event(place, "close")]
            elif not word:
                events.append(Event(place, "call", m[2]))
                self._passed(m[2], place, (m.end(), closing(self.text, m.end() - 1, "()")))
        return events

    def _passed(self, function: str, place: int, given: Span) -> None:
        """Names that a function is given: where it moves to them is not determined. Calls within calls are of the outer one."""
        if place < self.passed:
            return
        self.passed = given[1] if given[1] > 0 else len(self.text)
        for name in re.findall(r"\w+", self.text[slice(*given)]):
            if name in self.named:
                self.named[name].changed = message(
                    "robot_programs.passed_2", function=function, name=self.source.name, line=self.source.line(place)
                )

    def _unnamed(self, argument: Span) -> Span:
        """Return the argument of pose=... or q=... without its name."""
        m = _KEY.match(self.text, *argument)
        return (m.end(), argument[1]) if m and m[1] in _TARGET_KEYS else argument

    def _tool(self, argument: Span) -> str:
        """The name of the tool that a set_tcp sets; one that is computed is stated nowhere."""
        word = self.text[slice(*argument)]
        name: str = message("robot_programs.set_tcp_of", where=self.reader.where(self.k, argument[0]))
        found = self._pose_of(argument)
        if found is not None:
            name = self.tools.setdefault(found.tobytes(), name)  # one that is set again is the same
            self.frames[name] = found
            if word in self.named:
                self.frames[word] = found
        return name

    def _pose_of(self, argument: Span) -> FloatArray | None:
        """The pose of a literal, or of a name that is set to one; None of anything else."""
        word = self.text[slice(*argument)]
        named = self.named.get(word)
        if named is not None:
            found = self._six(named.span) if named.is_pose else None
        else:
            found = self._six((argument[0] + 1, argument[1])) if word.startswith("p[") else None
        return None if found is None or wrong([v for v, _ in found]) else _pose([v for v, _ in found])

    def _moved(self, move: str, argument: Span, tools: set[str]) -> None:
        text, whole, near = self.text, argument, set[tuple[float, ...]]()
        of_inverse = _INVERSE.match(text[slice(*argument)])
        if of_inverse:
            given = self._inverse(argument, argument[0] + of_inverse.end())
            if given is None:
                self._computed(move, whole)
                return
            argument, near, tool = given
            tools = {tool} if tool else tools
        operand, base = text[slice(*argument)], "base"
        trans = _TRANS.match(operand)
        if trans:
            start = argument[0] + trans.end()
            end = closing(text, start, "()")
            parts = pieces(text, (start + 1, end))
            if len(parts) != 2 or end + 1 != argument[1] or not re.fullmatch(r"\w+", text[slice(*parts[0])]):
                self._computed(move, whole)
                return
            base, argument = text[slice(*parts[0])], parts[1]
            operand = text[slice(*argument)]
            found = self._pose_of(parts[0])
            if found is not None:
                self.frames[base] = found
        line = f"{move} of line {self.source.line(argument[0])}"
        frames = {(base, tool) for tool in tools}
        if operand.startswith(("p[", "[")):
            is_pose = operand.startswith("p")
            self._take(line, _Literal(is_pose, (argument[0] + is_pose, argument[1]), frames, near, argument[0]))
        elif operand in self.named:
            named = self.named[operand]
            named.used |= frames
            named.near |= near
            named.first = named.first if named.first >= 0 else argument[0]
        else:
            self._computed(move, whole)

    def _inverse(self, argument: Span, start: int) -> tuple[Span, set[tuple[float, ...]], str] | None:
        """The pose, joint values near it and the tool of get_inverse_kin(x, qnear, tcp=...); None where one is computed."""
        text, end = self.text, closing(self.text, start, "()")
        if end + 1 != argument[1]:
            return None
        given: dict[str, Span] = {}
        for key, part in zip(_INVERSE_KEYS, pieces(text, (start + 1, end)), strict=False):
            m = _KEY.match(text, *part)
            given[m[1] if m else key] = (m.end(), part[1]) if m else part
        if "x" not in given or set(given) - set(_INVERSE_KEYS):
            return None
        near, tool = set[tuple[float, ...]](), ""
        if "qnear" in given:
            word = text[slice(*given["qnear"])]
            found = self._six(self.named[word].span if word in self.named else given["qnear"])
            if found is None:
                return None
            self.aside.add(word)
            near = {tuple(v for v, _ in found)}
        if "tcp" in given:
            tool = self._tool(given["tcp"])
        return given["x"], near, tool

    def _computed(self, move: str, argument: Span) -> None:
        self.leave(argument[0], message("robot_programs.target_computed_set_elsewhere", move=move, v2=self.text[slice(*argument)]))

    def _take(self, name: str, literal: _Literal) -> None:
        found, used = self._six(literal.span), literal.used
        if found is None:
            self.leave(literal.span[0], message("program.not_six", name=name))
        elif why := wrong([v for v, _ in found]):
            self.leave(literal.span[0], why, name)
        elif len(used) > 1 and literal.is_pose:
            self.reader.leave_in_several(self.k, literal.span[0], name, used)
        elif literal.changed:
            self.leave(literal.span[0], literal.changed, name)
        elif len(literal.near) > 1:
            self.leave(literal.span[0], message("robot_programs.several_ways_stated", name=name))
        else:
            values, spans = zip(*found, strict=True)
            line, near = self.source.line(literal.span[0]), next(iter(literal.near), ())
            moved = self.k, literal.first
            self.reader.targets.append(Target(name, self.k, line, not literal.is_pose, values, spans, *min(used), moved=moved, near=near))

    def _six(self, span: Span) -> list[tuple[float, Span]] | None:
        """Return the six numbers of a list in brackets, with their places; None for any other content."""
        if self.text[span[0] : span[0] + 1] != "[" or closing(self.text, span[0], "[]") != span[1] - 1:
            return None
        parts = pieces(self.text, (span[0] + 1, span[1] - 1))
        plain = all(re.fullmatch(NUMBER, self.text[slice(*p)]) for p in parts)
        return numbers_in(self.text, (span[0] + 1, span[1] - 1)) if plain and len(parts) == 6 else None

    def leave(self, place: int, why: str, name: str = "") -> None:
        self.reader.leave(self.k, place, why, name)


def _with_tool(tool: State, state: State) -> State:
    return (*tool, state[1])


def _along(by: str, state: State) -> State:
    return state[0], by


def _pose(values: Sequence[float]) -> FloatArray:
    return se3.pose([1000.0 * v for v in values[:3]], Rotation.from_rotvec(np.asarray(values[3:6], dtype=np.float64)))


def _numbers(row: FloatArray, old: Sequence[float]) -> FloatArray:
    vector = se3.rotation(row).as_rotvec()
    before, angle = np.asarray(old[3:6], dtype=np.float64), float(np.linalg.norm(vector))
    # the same rotation the other way about, or whole turns further, where the old one was written so
    if angle > 0.0:
        axis = vector / angle
        vector = axis * (angle + 2.0 * np.pi * np.round((before @ axis - angle) / (2.0 * np.pi)))
    return np.concatenate([row[:3] / 1000.0, vector])


DIALECT = Dialect("ur-script", read, _pose, _numbers, 1.0, (7, 7, 7), suffixes=(".script", ".urscript"))
