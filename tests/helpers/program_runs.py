"""KRL and script programs are run for the tests, with conditions by chance, by code that shares nothing with lmeasure: by source and place
of its first number, every flange pose (4, 4) that was met, None in a frame that is not known, or joint values, with the target's flags."""

import re
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from program_words import Met, abc, numbered, vector

STEPS, RUNS = 600, 120


@dataclass
class Line:
    """One statement: what it does to the flow, a name, and what it does besides."""

    kind: str = ""
    name: str = ""
    do: Callable[[Any], None] | None = None


def following(lines: list[Line]) -> list[list[int]]:
    """Where one may go from each line of a routine; past the last one it is left."""
    after = [[i + 1] for i in range(len(lines))]
    labels = {line.name: i for i, line in enumerate(lines) if line.kind == "label"}
    opened: list[tuple[int, list[int], list[int]]] = []  # a block's first line, its elses, and what leaves or goes on with it
    for i, line in enumerate(lines):
        if line.kind in ("if", "switch", "loop", "ever"):
            opened.append((i, [], []))
        elif line.kind == "else":
            opened[-1][1].append(i)
        elif line.kind in ("exit", "next"):
            next(block for block in reversed(opened) if lines[block[0]].kind in ("loop", "ever"))[2].append(i)
        elif line.kind in ("close", "until"):
            start, elses, jumps = opened.pop()
            kind = lines[start].kind
            for j in jumps:
                after[j] = [i + 1] if lines[j].kind == "exit" else [i]
            for e in elses:
                after[e] = [i + 1]
            if kind in ("loop", "ever"):
                after[start] = [start + 1] if kind == "ever" else [start + 1, i + 1]
                after[i] = [start, i + 1] if line.kind == "until" else [start]
            else:
                whole = any(lines[e].name == "whole" for e in elses)
                after[start] = [start + 1] * (kind == "if") + [e + 1 for e in elses] + [i + 1] * (not whole)
        elif line.kind == "goto":
            after[i] = [labels[line.name]]
        elif line.kind in ("return", "halt"):
            after[i] = []
    return after


def run(routines: dict[str, list[Line]], name: str, state: Any, rng: np.random.Generator, left: list[int]) -> bool:
    """A routine, line by line, ways by chance; False where the program ended in it."""
    lines, at = routines[name], 0
    after = following(lines)
    while at < len(lines):
        left[0] -= 1
        if left[0] < 0 or lines[at].kind == "halt":
            return False
        do = lines[at].do
        if do is not None:
            do(state)
        if lines[at].kind == "call" and lines[at].name in routines and not run(routines, lines[at].name, state, rng, left):
            return False
        if not after[at]:
            return True
        at = int(rng.choice(after[at]))
    return True


def reported(frames: dict[str, str], state: dict[str, str]) -> None:
    state.update(frames)


def krl(sources: dict[str, str], frames: dict[str, np.ndarray]) -> Met:
    """Values of names are those of the data; a target that is changed, passed on, partial or in an array is none."""
    number = re.compile(r"([A-Z]\d?)\s+([-+]?[\d.]+(?:E[-+]?\d+)?|'B[01]+')", re.I)
    known: dict[str, tuple[tuple[str, int], dict[str, float]]] = {}
    at_frames = dict(frames) | {"$NULLFRAME": np.eye(4)}
    fdat: dict[str, tuple[str, str]] = {}
    routines: dict[str, list[Line]] = {}
    lines: list[Line] = []
    called: set[str] = set()
    spline: list[str] = []
    met: Met = defaultdict(list)

    def aggregate(name: str, at: int, body: str) -> tuple[tuple[str, int], dict[str, float]] | None:
        start = body.index("{")
        inner = re.sub(r"\{\s*\w+\s*:", lambda m: " " * len(m[0]), body[start : body.index("}")])
        found = list(number.finditer(inner))
        values = {m[1].upper(): float(int(m[2][2:-1], 2)) if m[2][0] == "'" else float(m[2]) for m in found}
        return ((name, at + start + found[0].start(2)), values) if found else None

    def numbered_frame(which: str, digits: str) -> str:
        return f"{which}_DATA[{int(digits)}]" if int(digits) else "$NULLFRAME"

    def frame(text: str, name: str, at: int) -> str:
        if "{" in text:
            found = aggregate(name, at, text)
            assert found is not None
            at_frames[str(found[0])] = abc([found[1][k] for k in "XYZABC"])
            return str(found[0])
        return text.strip().upper().replace(" ", "")

    def moves(name: str, at: int, rest: str, count: int, header: list[str]) -> Callable[[dict[str, str]], None]:
        operands = [(m.start(), m[0]) for m in re.finditer(r"\{[^}]*\}(?:\s*:\s*\{)?|[^,{}\s][^,{}]*", rest)][:count]

        def do(state: dict[str, str]) -> None:
            own = dict(state)
            for clause in [*header, rest]:
                for m in re.finditer(r"\$(BASE|TOOL)\s*=\s*([^,{]+?)\s*(?=,|$|C_SPL)", clause, re.I):
                    of = re.match(r"S(?:BASE|TOOL2?)\((\w+)", m[2], re.I)
                    own[m[1].upper()] = fdat[of[1].upper()][m[1].upper() == "TOOL"] if of else frame(m[2], name, at)
            for start, operand in operands:
                word = operand.split(" WITH")[0].split()[0].upper()
                found = aggregate(name, at + start, operand) if operand[0] == "{" else known.get(word)
                if ":" in re.sub(r"^\{\s*\w+\s*:", "", operand) or found is None:
                    continue
                place, values = found
                flags = {k: int(values[k]) for k in "ST" if k in values}
                if "A6" in values:
                    met[place].append(([values[f"A{i}"] for i in range(1, 7)], {}))
                elif all(k in values for k in "XYZABC"):
                    base, tool = at_frames.get(own["BASE"]), at_frames.get(own["TOOL"])
                    pose = None if base is None or tool is None else base @ abc([values[k] for k in "XYZABC"]) @ np.linalg.inv(tool)
                    met[place].append((pose, flags))

        return do

    m: Any
    data: Any
    sets: Any
    by: Any
    for name, text in sources.items():
        for at, line in numbered(text, ";", '"'):
            m = re.match(r"\s*(?:DECL\s+|GLOBAL\s+)*(E6POS|POS|E6AXIS|AXIS|FRAME|FDAT)\s+(\w+)\s*=(.*)", line, re.I)
            data = re.match(r"\s*((?:BASE|TOOL)_DATA\[\d+\])\s*=(.*)", line, re.I)
            if m and m[1].upper() == "FDAT":
                n = dict(re.findall(r"(TOOL|BASE)_NO\s+(\d+)", line))
                fdat[m[2].upper()] = numbered_frame("BASE", n["BASE"]), numbered_frame("TOOL", n["TOOL"])
            elif m or data:
                found = aggregate(name, at + (m or data).start(3 if m else 2), (m[3] if m else data[2]))
                assert found is not None
                if data or m[1].upper() == "FRAME":
                    at_frames[(m[2] if m else data[1]).upper()] = abc([found[1][k] for k in "XYZABC"])
                else:
                    known[m[2].upper()] = found
    for line in (line for text in sources.values() for _, line in numbered(text, ";", '"')):
        m = re.match(r"\s*(\w+(?:\[\d+\])?)\s*(\.\w+)?\s*=", line)
        if m and "." in m[0]:
            known.pop(m[1].upper(), None)
            at_frames.pop(m[1].upper(), None)
    for name, text in sources.items():
        for at, line in numbered(text, ";", '"'):
            word = (re.findall(r"^\s*(\w+)", line) or [""])[0].upper()
            m = re.match(r"\s*(S?(?:PTP|LIN|CIRC)|SPL)\s+(.*)", line, re.I)
            sets = re.match(r"\s*\$(BASE|TOOL)\s*=\s*(.*)", line, re.I)
            by = re.match(r"\s*BAS\s*\(\s*#(BASE|TOOL)\s*,\s*(\d+)", line, re.I)
            act = re.match(r"\s*FDAT_ACT\s*=\s*(\w+)", line, re.I)
            call = re.match(r"\s*(\w+)\s*\(([^)]*)\)\s*$", line)
            if word == "DEF":
                lines = routines.setdefault(line.split("(")[0].split()[1].upper(), [])
            elif m:
                count = 2 if m[1].upper().endswith("CIRC") else 1
                lines.append(Line("", do=moves(name, at + m.start(2), m[2], count, list(spline))))
            elif sets or by:
                which = (sets or by)[1].upper()
                value = frame(sets[2], name, at + sets.start(2)) if sets else numbered_frame(which, by[2])
                lines.append(Line("", do=partial(reported, {which: value})))
            elif act:
                base, tool = fdat[act[1].upper()]
                lines.append(Line("", do=partial(reported, {"BASE": base, "TOOL": tool})))
            elif word == "SPLINE":
                spline = [line]
            elif word == "ENDSPLINE":
                spline = []
            elif word in ("IF", "SWITCH"):
                lines.append(Line(word.lower()))
            elif word in ("ELSE", "CASE", "DEFAULT"):
                lines.append(Line("else", "" if word == "CASE" else "whole"))
            elif word in ("FOR", "WHILE", "LOOP", "REPEAT"):
                lines.append(Line("ever" if word in ("LOOP", "REPEAT") else "loop"))
            elif word in ("ENDIF", "ENDSWITCH", "ENDFOR", "ENDWHILE", "ENDLOOP", "UNTIL"):
                lines.append(Line("until" if word == "UNTIL" else "close"))
            elif word in ("EXIT", "RETURN", "HALT"):
                lines.append(Line("" if word == "HALT" else word.lower()))
            elif word == "GOTO" or re.match(r"\s*\w+\s*:\s*$", line):
                lines.append(Line("goto" if word == "GOTO" else "label", line.split()[-1].rstrip(":").upper()))
            elif call and word != "BAS":
                called |= {call[1].upper()}
                for given in re.findall(r"\w+", call[2]):
                    known.pop(given.upper(), None)
                lines.append(Line("call", call[1].upper()))
    for seed in range(RUNS):
        for routine in routines:
            if routine not in called:
                run(routines, routine, {"BASE": "?", "TOOL": "?"}, np.random.default_rng([seed, len(routine)]), [STEPS])
    return met


class Pose:
    """A pose of a script: its matrix, and where its first number stands, or -1 of one that is computed."""

    def __init__(self, numbers: list[float], at: int = -1, base: np.ndarray | None = None) -> None:
        self.numbers, self.at, self.base = numbers, at, np.eye(4) if base is None else base

    @property
    def matrix(self) -> np.ndarray:
        return self.base @ vector(self.numbers)

    def __add__(self, other: Any) -> "Unknown":
        return Unknown()


class Unknown:
    """Whatever a test does not look into."""

    def __call__(self, *_: Any, **__: Any) -> "Unknown":
        return Unknown()

    def __getattr__(self, _: str) -> "Unknown":
        return Unknown()

    def _two(self, _: Any) -> "Unknown":
        return Unknown()

    __add__ = __radd__ = __sub__ = __mul__ = __truediv__ = __mod__ = __gt__ = __lt__ = __eq__ = __getitem__ = _two  # type: ignore[assignment]
    __hash__ = None  # type: ignore[assignment]


class Names(dict[str, Any]):
    def __missing__(self, key: str) -> Any:
        return Unknown()


def placed_literals(line: str, at: int) -> str:
    """Each literal knows where its first number stands."""
    number = r"[-+]?[\d.]+(?:[eE][-+]?\d+)?"
    six = rf"\[\s*(({number})(?:\s*,\s*{number}){{5}})\s*\]"
    code = re.sub("p" + six, lambda m: f"P([{m[1]}], {at + m.start(1)})" if "1e300" not in m[1] else "None", line)
    code = re.sub(rf"(?<![(\w]){six}", lambda m: f"[{m[1]}, {at + line.index(m[1])}]", code)
    return re.sub(r"(movej\(|near=)" + six, lambda m: f"{m[1]}[{m[2]}, {at + line.index(m[2])}]", code)


def script(text: str) -> Met:
    """Python runs its statements, which look like its own; functions of the program that take something are not followed into."""
    met: Met = defaultdict(list)
    routines: dict[str, list[Line]] = {"": []}
    stack: list[tuple[str, str]] = []
    given: set[str] = set()

    def move(state: Names, *targets: Any) -> None:
        for target in targets:
            tool = state["__tool"]
            if isinstance(target, tuple):  # of get_inverse_kin
                target, own = target
                tool = own if own is not None else tool
            if isinstance(target, Pose) and target.at >= 0:
                met["", target.at].append((target.matrix @ np.linalg.inv(tool.matrix) if isinstance(tool, Pose) else None, {}))
            elif isinstance(target, list) and len(target) == 7 and all(isinstance(v, float | int) for v in target):
                met["", target[6]].append((target[:6], {}))

    def trans(frame: Any, pose: Any) -> Any:
        whole = isinstance(frame, Pose) and isinstance(pose, Pose) and frame.at >= 0 and np.array_equal(pose.base, np.eye(4))
        return Pose(pose.numbers, pose.at, frame.matrix @ pose.base) if whole else Unknown()

    def statement(code: str) -> Callable[[Names], None]:
        def do(state: Names) -> None:
            calls: dict[str, Any] = dict.fromkeys(("movej", "movel", "movep", "servoj"), lambda *t, **_: move(state, t[0]))
            calls["movec"] = lambda *t, **_: move(state, *t[:2])
            state.update(calls, P=Pose, pose_trans=trans, set_tcp=lambda t, *_: state.__setitem__("__tool", t))
            state["get_inverse_kin"] = lambda x, qnear=None, tcp=None, **_: (x, tcp)
            exec(code, {"__builtins__": {}}, state)

        return do

    for at, line in numbered(text, "#", "\"'", "0"):
        code = placed_literals(line, at)
        code = re.sub(r"^(global|local)\s+", "", code.strip())
        word = (re.findall(r"^\w+", code) or [""])[0]
        lines = routines[next((name for kind, name in reversed(stack) if kind == "def"), "")]
        if word in ("def", "thread"):
            name = re.findall(r"\w+", code)[1]
            stack.append(("def", name))
            routines.setdefault(name, [])
        elif word in ("if", "while"):
            stack.append((word, ""))
            lines.append(Line("if" if word == "if" else "loop"))
        elif word in ("elif", "else"):
            lines.append(Line("else", "whole" if word == "else" else ""))
        elif word == "end":
            kind, _ = stack.pop()
            if kind != "def":
                lines.append(Line("close"))
        elif word in ("break", "continue", "return", "halt"):
            lines.append(Line({"break": "exit", "continue": "next"}.get(word, word)))
        elif code and word not in ("run", "sync") and code[0] != "$":
            own = next((name for name in routines if re.search(rf"\b{name}\(", code) and name), "")
            lines.append(Line("call", own) if own else Line("", do=statement(code)))
            given |= set(re.findall(r"\w+", code[code.index(own) :])) if own else set()
    whole = next(name for name in routines if name)
    for seed in range(RUNS):
        run(routines, whole, Names(), np.random.default_rng([seed, 7]), [STEPS])
    passed = [m.end() for m in re.finditer(r"(\w+)\s*=\s*p\[", text) if m[1] in given]
    return {place: every for place, every in met.items() if place[1] not in passed}
