"""In which frames a program's motions are carried out, whichever ways it goes: conditions, loops, jumps and subroutines, all at once.

What holds at a place is a set of states, each what the program may have set last. A branch leaves what any of its ways leaves, a loop what
none, one or many rounds leave or what it is left with in the middle, a label what any jump to it brings, a call what the subroutine leaves
of what it was called with. A motion with several states is in several frames, one without any is never made. Interrupts are not followed.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal

from lmeasure.core import RobotError
from lmeasure.text import message

State = tuple[str, ...]
States = frozenset[State]
NONE: States = frozenset()
DEEPEST, MOST_STATES, MOST_ROUNDS = 100, 1000, 1000
"""Blocks within each other, states at one place, and rounds through the program until nothing is new: more are no program of a robot."""


@dataclass(frozen=True)
class Event:
    """Something that a program does at a place. begin, finish: of the subroutine `name`, which may stand in another; branch, else, loop,
    close: of a block, branch of the name "switch" where the first of its ways begins with an else, else with `whole` where nothing is left
    beside it, loop where only an exit ends it; exit, next: of the loop that it
    stands in; return: of the subroutine; jump, label: of that `name`; set: `change` of the state; call: of `name`; move: asked for."""

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
    """Knowledge so far, which only grows: states that subroutines are entered and left with, that jumps bring to a subroutine's labels,
    that motions are made in, and that loops are begun with; of the loop that is gone through, what it is left with and begun again with."""

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
            # what is only called from itself, or never reached, begins anyhow
            lost = [name for name, found in flow.entry.items() if not found]
            if not lost:
                return flow.seen
            flow.entry[lost[0]] = frozenset({start})
    raise RobotError(message("error.program_too_deep"))


def _bodies(events: Iterable[Event]) -> dict[str, _Body]:
    """Events and blocks of each subroutine; what stands in none is of that without a name."""
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
    """Return what a body of the subroutine `name` leaves of these states; `flow` grows."""
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
