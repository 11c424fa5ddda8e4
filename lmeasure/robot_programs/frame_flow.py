"""Frames of a program's motions on all its paths: conditions, loops, jumps and subroutines, all at once.

At each place there is a set of states, each a possible last setting of the program. A branch unites the states of its paths. A loop unites
those of none, one or many rounds and of its exits, a label those of all jumps to it. A call applies the subroutine to its states. A motion
with several states is in several frames, one without any is never made. Interrupts are not followed.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Literal

from lmeasure.core import RobotError
from lmeasure.robot_programs.program import Span, pieces
from lmeasure.text import message

State = tuple[str, ...]
States = frozenset[State]
NONE: States = frozenset()
DEEPEST, MOST_STATES, MOST_ROUNDS = 100, 1000, 1000
"""Blocks within each other, states at one place, and rounds through the program until nothing is new: more are no program of a robot."""


@dataclass(frozen=True)
class Event:
    """Event of a program at a place. begin, finish: of the subroutine `name`, which may be inside another; branch, else, loop, close: of a
    block, branch of the name "switch" if the first of its paths begins with an else, else with `whole` for the last alternative, loop that
    only an exit ends; exit, next: of the loop around it; return: of the subroutine; jump, label: of that `name`; set: `change` of the
    state; call: of `name`; move: a motion."""

    place: int
    kind: Literal["begin", "finish", "branch", "else", "loop", "close", "exit", "next", "return", "jump", "label", "set", "call", "move"]
    name: str = ""
    change: Callable[[State], State] | None = None
    whole: bool = False


@dataclass
class _Block:
    kind: str
    ways: list[list["Event | _Block"]]
    whole: bool = False
    first: bool = False


_Body = list[Event | _Block]


@dataclass
class _Flow:
    """Known states, which only grow: at entry and exit of subroutines, at labels from jumps, at motions, and at the start of loops; for the
    present loop, at its exits and at its repetition."""

    entry: dict[str, States]
    leaves: dict[str, States]
    seen: dict[int, States]
    jumps: dict[tuple[str, str], States] = field(default_factory=dict)
    exits: States = NONE
    again: States = NONE
    loops: dict[int, States] = field(default_factory=dict)

    def sizes(self) -> list[int]:
        return [len(s) for known in (self.entry, self.leaves, self.jumps, self.seen, self.loops) for s in known.values()]


def states(events: Iterable[Event], start: State) -> dict[int, States]:
    """States in which the motions at their places may be made; subroutines that nothing calls begin in `start`."""
    bodies = _bodies(events)
    every = [e for body in bodies.values() for e in _all(body)]
    called = {e.name for e in every if e.kind == "call"}
    entry = {name: NONE if name in called else frozenset({start}) for name in bodies}
    flow = _Flow(entry, dict.fromkeys(bodies, NONE), {e.place: NONE for e in every if e.kind == "move"})
    for _ in range(MOST_ROUNDS):
        before = flow.sizes()
        for name, body in bodies.items():
            end = _after(body, flow.entry[name], flow, name)
            flow.leaves[name] |= end
        if flow.sizes() == before:
            # routines that only call themselves, or are never reached, also begin
            lost = [name for name, found in flow.entry.items() if not found]
            if not lost:
                return flow.seen
            flow.entry[lost[0]] = frozenset({start})
    raise RobotError(message("error.program_too_deep"))


def _bodies(events: Iterable[Event]) -> dict[str, _Body]:
    """Return events and blocks of each subroutine; those outside all belong to the one without a name."""
    bodies: dict[str, _Body] = {"": []}
    here, open_blocks, outer = bodies[""], list[tuple[_Block, _Body]](), list[tuple[_Body, list[tuple[_Block, _Body]]]]()
    for event in events:
        if event.kind == "begin":
            outer.append((here, open_blocks))
            here, open_blocks = bodies.setdefault(event.name, []), []
        elif event.kind == "finish":
            here, open_blocks = outer.pop() if outer else (bodies[""], [])
        elif event.kind in ("branch", "loop"):
            if len(open_blocks) >= DEEPEST:
                raise RobotError(message("error.program_too_deep"))
            block = _Block(event.kind, [[]], event.whole, event.name == "switch")
            here.append(block)
            open_blocks.append((block, here))
            here = block.ways[-1]
        elif event.kind == "else" and open_blocks:
            block = open_blocks[-1][0]
            block.whole |= event.whole
            if not block.first:
                block.ways.append([])
            block.first = False
            here = block.ways[-1]
        elif event.kind == "close":
            here = open_blocks.pop()[1] if open_blocks else here
        elif event.kind != "else":
            here.append(event)
    return bodies


def _all(body: _Body) -> Iterable[Event]:
    for one in body:
        if isinstance(one, Event):
            yield one
        else:
            for way in one.ways:
                yield from _all(way)


def _after(body: _Body, states: States, flow: _Flow, name: str) -> States:
    """Return the states after a body of the subroutine `name`; `flow` grows."""
    for one in body:
        if isinstance(one, _Block):
            states = _after_loop(one, states, flow, name) if one.kind == "loop" else _after_branch(one, states, flow, name)
        elif one.kind == "set" and one.change is not None:
            states = frozenset(one.change(s) for s in states)
        elif one.kind == "call" and one.name in flow.entry:
            flow.entry[one.name] |= states
            states = flow.leaves[one.name] if states else NONE
        elif one.kind == "move":
            flow.seen[one.place] |= states
        elif one.kind == "label":
            states |= flow.jumps.get((name, one.name), NONE)
        elif one.kind in ("exit", "next", "return", "jump"):
            if one.kind == "exit":
                flow.exits |= states
            elif one.kind == "next":
                flow.again |= states
            elif one.kind == "return":
                flow.leaves[name] |= states
            else:
                flow.jumps[name, one.name] = flow.jumps.get((name, one.name), NONE) | states
            states = NONE
    return states


def _after_branch(block: _Block, states: States, flow: _Flow, name: str) -> States:
    ends = [_after(way, states, flow, name) for way in block.ways]
    out = NONE.union(*ends, *(() if block.whole else (states,)))
    if len(out) > MOST_STATES:
        raise RobotError(message("error.program_too_deep"))
    return out


def _after_loop(block: _Block, states: States, flow: _Flow, name: str) -> States:
    outside, flow.exits, flow.again = (flow.exits, flow.again), NONE, NONE
    states |= flow.loops.get(id(block), NONE)
    states |= _after(block.ways[0], states, flow, name) | flow.again
    flow.loops[id(block)] = states
    states = flow.exits if block.whole else states | flow.exits
    flow.exits, flow.again = outside
    return states


NULL = "$NULLFRAME"
FIXED = ("fixed tool", "")
"""Frames of a motion of a workpiece on the robot to a fixed tool."""
_STATEMENT = re.compile(
    r"^[ \t]*(?:(?P<move>S?(?:PTP|LIN|CIRC)(?:_REL)?|SPL(?:_REL)?)\b[ \t]*(?P<rest>.*)"
    r"|(?:PTP_)?(?P<spline>SPLINE)\b(?P<header>.*)|(?P<ends>ENDSPLINE)\b"
    r"|\$(?P<frame>BASE|TOOL)\s*(?:\.\s*\w+\s*=|=\s*(?P<value>.*))|\$IPO_MODE\s*=\s*#(?P<mode>\w+)"
    r"|(?:GLOBAL\s+)?(?P<block>IF|ELSE|ENDIF|SWITCH|CASE|DEFAULT|ENDSWITCH|FOR|ENDFOR|WHILE|ENDWHILE|REPEAT|UNTIL|LOOP|ENDLOOP"
    r"|DEFFCT|DEF|ENDFCT|END)\b(?:(?<=DEF)\s+(?P<def>\w+)|(?<=DEFFCT)\s+\w+\s+(?P<fct>\w+))?"
    r"|(?P<leaves>EXIT|RETURN)\b|GOTO\s+(?P<goto>\w+)|(?P<label>\w++)[ \t]*+:[ \t]*\r?$"
    r"|BAS\s*\(\s*#(?P<bas>BASE|TOOL)\s*,\s*(?P<number>\d{1,9})\s*\)|BAS\s*\(\s*#(?P<again>INITMOV|BASE|TOOL|EX_BASE)\b"
    r"|FDAT_ACT\s*(?:=\s*(?:(?P<fdat>\w+)|(?P<list>\{.*\}))|(?P<part>\.))"
    r"|(?P<call>[A-Z]\w*+)[ \t]*+\((?P<given>.*)\)|(?P<assigned>[$\w.]++[ \t]*+(?:\[[^\]\n]*\])?+[\w.]*+[ \t]*+=)(?!=))",
    re.I | re.M,
)
FrameOf = Callable[[int, str, Span], str]
"""The name of the frame that BASE or TOOL is set to, of a source and the place of the value."""
FdatOf = Callable[[int, str], tuple[str, str] | None]
"""The frames of an FDAT of that name that the module of a source declares."""


@dataclass(frozen=True)
class Motion:
    """Source and place of a motion, kind, the place behind its kind, the statements of its spline, and its possible frames (base, tool),
    none for an unreachable one."""

    source: int
    place: int
    kind: str
    rest: Span
    spline: tuple[Span, ...]
    states: States


def motions(texts: Sequence[str], modules: Sequence[str], frame_of: FrameOf, fdat_of: FdatOf) -> Iterator[Motion]:
    """All files together: subroutines of one are called in another."""
    offsets = list(accumulate((len(text) + 1 for text in texts), initial=0))
    events: list[Event] = []
    moves: dict[int, tuple[int, re.Match[str], tuple[Span, ...]]] = {}
    defined = {(modules[k], (m["def"] or m["fct"]).upper()) for k, m in _statements(texts) if m["def"] or m["fct"]}

    def called(k: int, name: str) -> str:
        own = [(modules[k], name), (name, name), *sorted(d for d in defined if d[1] == name)]
        return ".".join(next((d for d in own if d in defined), ("", name)))

    spline: tuple[Span, ...] = ()
    here = -1
    for k, m in _statements(texts):
        place = offsets[k] + m.start()
        if k != here:
            here, spline = k, ()
            events.append(Event(offsets[k], "begin", f"file {k}"))
        if m["move"]:
            moves[place] = (k, m, spline)
            events.append(Event(place, "move"))
        elif m["spline"] or m["ends"]:
            spline = tuple(pieces(texts[k], m.span("header"))) if m["spline"] else ()
        elif m["block"]:
            # a function in a condition is called before the branch is known
            if not (m["def"] or m["fct"]):
                events += [Event(place, "call", called(k, name)) for name, _ in functions(texts[k], m.span())]
            events.append(_block(place, m["block"].upper(), f"{modules[k]}.{(m['def'] or m['fct'] or '').upper()}"))
        elif m["leaves"]:
            events.append(Event(place, "exit" if m["leaves"].upper() == "EXIT" else "return"))
        elif m["goto"] or m["label"]:
            events.append(Event(place, "jump" if m["goto"] else "label", (m["goto"] or m["label"]).upper()))
        elif m["call"]:
            events.append(Event(place, "call", called(k, m["call"].upper())))
        elif m["assigned"]:
            events += [Event(place, "call", called(k, name)) for name, _ in functions(texts[k], m.span())]
        else:
            events.append(Event(place, "set", change=_change(k, m, frame_of, fdat_of)))
    found = states(events, ("$BASE", "$TOOL", ""))
    for place, (k, m, around) in moves.items():
        made = frozenset((base, tool) if mode != "TCP" else FIXED for base, tool, mode in found[place])
        yield Motion(k, m.start("move"), m["move"].upper(), m.span("rest"), around, made)


def calls(text: str) -> Iterator[tuple[str, int, str]]:
    """Yield called subroutines: name, place, arguments; of functions those that the program or an EXTFCT declares."""
    own = {m[1].upper() for m in re.finditer(r"^[ \t]*(?:GLOBAL\s+)?(?:DEFFCT|EXTFCT)\s+\w+\s+(\w+)", text, re.I | re.M)}
    for m in _STATEMENT.finditer(text):
        if m["call"]:
            yield m["call"], m.start("call"), m["given"]
        elif m["assigned"] or (m["block"] and not (m["def"] or m["fct"])):
            yield from ((name, m.start(), given) for name, given in functions(text, m.span()) if name in own)


def functions(text: str, span: Span) -> Iterator[tuple[str, str]]:
    """Yield possible calls within a statement: a name in capitals, and its arguments."""
    end = text.find("\n", span[0] + len(text[slice(*span)]) - len(text[slice(*span)].lstrip()))
    for m in re.compile(r"\b([A-Z]\w*+)\s*+\(([^()]*+)\)", re.I).finditer(text, span[0], end if end >= 0 else len(text)):
        yield m[1].upper(), m[2]


def fdat_frames(text: str) -> tuple[str, str]:
    """Base and tool of the list of an FDAT."""
    numbers = dict(re.findall(r"(TOOL_NO|BASE_NO)\s+(\d{1,9})", text.upper()))
    if "#TCP" in text.upper() or len(numbers) < 2:
        return FIXED
    return numbered("BASE", numbers["BASE_NO"]), numbered("TOOL", numbers["TOOL_NO"])


def numbered(which: str, number: str) -> str:
    """The name of the frame of that number; 0 is none."""
    plain = number.lstrip("0")
    return f"{which.upper()}_DATA[{plain}]" if plain else NULL


def _statements(texts: Sequence[str]) -> Iterator[tuple[int, re.Match[str]]]:
    return ((k, m) for k, text in enumerate(texts) for m in _STATEMENT.finditer(text))


def _change(k: int, m: re.Match[str], frame_of: FrameOf, fdat_of: FdatOf) -> Callable[[State], State]:
    """Return the effect of a statement on base and tool."""
    if m["mode"]:
        mode = m["mode"].upper()
        return lambda s: (s[0], s[1], mode)
    if m["fdat"] or m["list"] or m["part"] or (m["again"] and m["again"].upper() == "INITMOV"):
        known = fdat_frames(m["list"]) if m["list"] else fdat_of(k, m["fdat"]) if m["fdat"] else None
        both = known or ("$BASE", "$TOOL")
        return lambda _: (*both, "")
    which = (m["bas"] or m["again"] or m["frame"]).upper().removeprefix("EX_")
    if m["bas"]:
        name = numbered(which, m["number"])
    elif m["value"]:
        name = frame_of(k, which, m.span("value"))
    else:
        name = message("robot_programs.changed_in_line", name=f"${which}", line=m.string.count("\n", 0, m.end()) + 1)
    return (lambda s: (name, *s[1:])) if which == "BASE" else (lambda s: (s[0], name, s[2]))


def _block(place: int, word: str, name: str) -> Event:
    if word in ("DEF", "DEFFCT"):
        return Event(place, "begin", name)
    if word in ("END", "ENDFCT"):
        return Event(place, "finish")
    if word in ("ELSE", "CASE", "DEFAULT"):
        return Event(place, "else", whole=word != "CASE")
    if word.startswith("END") or word == "UNTIL":
        return Event(place, "close")
    if word in ("IF", "SWITCH"):
        return Event(place, "branch", word.lower())
    return Event(place, "loop", whole=word == "LOOP")
