"""In which frames a program's motions are carried out, whichever ways it goes: conditions, loops and subroutines are followed, all at once.

What holds at a place is a set of states, each what the program may have set last. A branch leaves what any of its ways leaves, a loop what
none, one or many rounds leave, a call what the subroutine leaves of what it was called with. A motion with several states is in several
frames. Jumps and interrupts are not followed.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

State = tuple[str, ...]
States = frozenset[State]


@dataclass(frozen=True)
class Event:
    """Something that a program does at a place. begin: of the subroutine `name`; branch, else, loop, close: of a block, else with `whole`
    where nothing is left beside it; set: `change` of the state; call: of `name`; move: asked for."""

    place: int
    kind: Literal["begin", "branch", "else", "loop", "close", "set", "call", "move"]
    name: str = ""
    change: Callable[[State], State] | None = None
    whole: bool = False


@dataclass
class _Block:
    kind: str
    ways: list[list["Event | _Block"]]
    whole: bool = False


def states(events: Iterable[Event], start: State) -> dict[int, States]:
    """States in which the motions at their places may be made; subroutines that nothing calls begin in `start`."""
    bodies = _bodies(events)
    called = {e.name for body in bodies.values() for e in _all(body) if e.kind == "call"}
    entry = {name: frozenset() if name in called else frozenset({start}) for name in bodies}
    leaves: dict[str, States] = dict.fromkeys(bodies, frozenset())
    seen: dict[int, States] = {}
    while True:
        before = dict(entry), dict(leaves)
        for name, body in bodies.items():
            leaves[name] |= _after(body, entry[name], entry, leaves, seen=seen)
        if (entry, leaves) == before:
            # what is only called from itself, or never reached, begins anyhow
            lost = [name for name, states in entry.items() if not states]
            if not lost:
                return seen
            entry[lost[0]] = frozenset({start})


def _bodies(events: Iterable[Event]) -> dict[str, list["Event | _Block"]]:
    """Events and blocks of each subroutine; what stands in none is of that without a name."""
    bodies: dict[str, list[Event | _Block]] = {"": []}
    here, open_blocks = bodies[""], list[tuple[_Block, list[Event | _Block]]]()
    for event in events:
        if event.kind == "begin":
            here, open_blocks = bodies.setdefault(event.name, []), []
        elif event.kind in ("branch", "loop"):
            block = _Block(event.kind, [[]])
            here.append(block)
            open_blocks.append((block, here))
            here = block.ways[-1]
        elif event.kind == "else" and open_blocks:
            block = open_blocks[-1][0]
            block.whole |= event.whole
            block.ways.append([])
            here = block.ways[-1]
        elif event.kind == "close":
            here = open_blocks.pop()[1] if open_blocks else here
        elif event.kind != "else":
            here.append(event)
    return bodies


def _all(body: Iterable["Event | _Block"]) -> Iterable[Event]:
    for one in body:
        if isinstance(one, Event):
            yield one
        else:
            for way in one.ways:
                yield from _all(way)


def _after(
    body: Iterable["Event | _Block"], states: States, entry: dict[str, States], leaves: Mapping[str, States], *, seen: dict[int, States]
) -> States:
    """What a body leaves of these states; `seen` and `entry` grow."""
    for one in body:
        if isinstance(one, _Block) and one.kind == "loop":
            while True:
                round_ = states | _after(one.ways[0], states, entry, leaves, seen=seen)
                if round_ == states:
                    break
                states = round_
        elif isinstance(one, _Block):
            ends = [_after(way, states, entry, leaves, seen=seen) for way in one.ways]
            states = frozenset().union(*ends, *(() if one.whole else (states,)))
        elif one.kind == "set" and one.change is not None:
            states = frozenset(one.change(s) for s in states)
        elif one.kind == "call" and one.name in entry:
            entry[one.name] |= states
            states = leaves[one.name]
        elif one.kind == "move":
            seen[one.place] = seen.get(one.place, frozenset()) | states
    return states
