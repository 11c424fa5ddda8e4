"""FANUC TP listings (.ls): positions P[n] of group 1 in user frames and tools; CONFIG is read, not changed.

X, Y, Z in mm and W, P, R in degrees: R = Rz(R) Ry(P) Rx(W). Frames are `UF[n]` and `UT[n]`; UF 0 is the robot's own. These positions are
unchanged: with an offset, a moving workpiece or a fixed tool, not taught (asterisks), with extended axes not at 0, and in frames that the
program sets.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.robot_programs.program import NUMBER, Dialect, Listing, Reader, Source, Span, Target, closing, of_angles, wrong
from lmeasure.text import message

POSE, AXES = ("X", "Y", "Z", "W", "P", "R"), tuple(f"J{i}" for i in range(1, 7))
_POSITION = re.compile(r'^[ \t]*P\[[ \t]*+(\d{1,9}+)[ \t]*+(?::[ \t]*+"?([^"\]\n]*+))?[^\]\n]*\]\s*+(?=\{)', re.M)
_MOTION = re.compile(r"^[ \t]*+\d*+[ \t]*+:[ \t]*([JLCAS])\s+", re.M)
_NAMED = re.compile(r"\b(PR?)\[\s*+([^\]:]{0,60}+)[^\]]{0,60}+\]")
_BY_DIFFERENCE = re.compile(r"\b(\w*OFFSET|INC|TRACK|COORD|RTCP)\b", re.I)
_ASSIGNED = re.compile(r"^[ \t]*+\d*+[ \t]*+:[ \t]*P\[[ \t]*(\d{1,9}+)[^\]\n]*\][ \t]*=", re.M)
_SET_FRAME = re.compile(r"^[ \t]*+\d*+[ \t]*+:[ \t]*(UFRAME|UTOOL)[ \t]*\[[ \t]*(?:GP\d+[ \t]*:[ \t]*)?(\w++)[^=\n]*=", re.M)
_FRAME = re.compile(r"\b(UF|UT)\s*+:\s*+(\w{1,99}+)")
_CURRENT = re.compile(r"^[ \t]*+\d*+[ \t]*+:[ \t]*(UFRAME_NUM|UTOOL_NUM)[ \t]*=[ \t]*(\w{1,99}+)", re.M)
_FIELD = re.compile(rf"\b([XYZWPR]|[JE]\d)\s*=\s*({NUMBER}|\*+)\s*(mm|deg)?")
_CONFIG = re.compile(
    r"CONFIG\s*:\s*'([NF])\s*(?:[LR]\s*)?([UD])?\s*([TB])\s*,\s*([-+]?\d{1,9})\s*,\s*([-+]?\d{1,9})\s*,\s*([-+]?\d{1,9})\s*'"
)
_pose, _numbers = of_angles("fanuc-wpr")


def read(sources: Sequence[Source]) -> Listing:
    """The targets of listings."""
    reader = Reader(sources, frames=("UF[0]", "UT[0]"))
    for k, source in enumerate(sources):
        _read(k, source, reader)
    return reader.listing()


def _read(k: int, source: Source, reader: Reader) -> None:
    text, leave = source.text, partial(reader.leave, k)
    body, positions = _sections(text)
    used: dict[int, set[str]] = {}
    first: dict[int, int] = {}
    for m, rest in _motions(text, body):
        if rest.startswith("!"):
            continue
        by, registers = _BY_DIFFERENCE.search(rest), list(_NAMED.finditer(rest))
        if not registers:
            leave(m.start(1), message("robot_programs.position_computed", m=m[1], m_=rest.strip().partition(" ")[0]))
        for register in registers:
            number = register[2].strip()
            if re.compile(r"\s*+=").match(rest, register.end()):
                continue  # position that a skip condition stores
            if register[1] == "PR" or not number.isdecimal():
                if not (by and register.start() > by.start()):
                    leave(m.start(1), message("robot_programs.position_computed_2", m=m[1], register=register[0]))
            else:
                used.setdefault(int(number), set()).add(by[1].upper() if by else "")
                first.setdefault(int(number), m.end() + register.start())
    current = {"UF": {m[2] for m in _CURRENT.finditer(text, *body) if m[1] == "UFRAME_NUM"}}
    current["UT"] = {m[2] for m in _CURRENT.finditer(text, *body) if m[1] == "UTOOL_NUM"}
    # of a number that is computed any may be meant
    set_here = {f"{m[1][:2]}[{m[2] if m[2].isdecimal() else ''}": source.line(m.start(1)) for m in _SET_FRAME.finditer(text, *body)}
    changed = {int(m[1]): source.line(m.start(1)) for m in _ASSIGNED.finditer(text, *body)}
    for m in _POSITION.finditer(text, *positions):
        number, end = int(m[1]), closing(text, m.end(), "{}")
        name = f"P[{number}]"
        if end < 0:
            leave(m.start(), message("program.unclosed", name=name))
            continue
        differences = sorted(d for d in used.get(number, set()) if d)
        if number not in used:
            leave(m.start(), message("robot_programs.no_motion_goes", name=name))
        elif number in changed:
            leave(m.start(), message("robot_programs.changed_program_2", name=name, name_=source.name, changed=changed[number]))
        elif differences:
            leave(m.start(), message("robot_programs.moved", name=name, how=tuple(differences)))
        else:
            found = _target(k, source, name, (m.end(), end), current)
            if isinstance(found, str):
                leave(m.start(), found, name)
                continue
            frame = next((f for t in found if not t.joints for f in (t.base, t.tool) if _set_at(f, set_here)), "")
            if frame:
                leave(
                    m.start(),
                    message(
                        "robot_programs.frame_set_program_2", name=name, frame=frame, name_=source.name, _set_at=_set_at(frame, set_here)
                    ),
                )
            else:
                reader.targets += [replace(t, moved=(k, first[number]), label=(m[2] or "").strip()) for t in found]


def _motions(text: str, body: Span) -> Iterator[tuple[re.Match[str], str]]:
    """Yield motions up to their semicolons, which may be in other lines."""
    start = body[0]
    while (end := text.find(";", start, body[1])) >= 0:
        if m := _MOTION.search(text, start, end):
            yield m, text[m.end() : end]
        start = end + 1


def _set_at(frame: str, set_here: Mapping[str, int]) -> int:
    """The line that sets a frame, 0 where none does: that of the robot, number 0, is never set."""
    which, number = frame[:2], frame[3:-1]
    return 0 if number == "0" else set_here.get(f"{which}[{number}", set_here.get(f"{which}[", 0))


def _target(k: int, source: Source, name: str, span: Span, current: dict[str, set[str]]) -> list[Target] | str:
    """The position between braces, twice where it is given by joint values and as a pose, or why it is none."""
    text = source.text
    start = text.find("GP1", *span)
    other = re.compile(r"GP[2-9]").search(text, *span)
    if start < 0:
        return message("robot_programs.no_group_1")
    stop = other.start() if other and other.start() > start else span[1]
    fields = {}
    for m in _FIELD.finditer(text, start, stop):
        if m[2].startswith("*"):
            return message("robot_programs.not_taught")
        unit = "mm" if m[1] in "XYZ" else "deg"
        if m[3] and m[3] != unit and m[1][0] != "E":
            return message("robot_programs.in_unit", name=m[1], unit=m[3])
        if m[1] in fields:
            return message("robot_programs.stated_twice", name=m[1])
        fields[m[1]] = (float(m[2]), m.span(2))
    both = all(key in fields for key in (*AXES, *POSE))
    joints = "J1" in fields and not both
    wanted = AXES if joints else POSE
    missing = [key for key in wanted if key not in fields]
    if missing:
        return message("robot_programs.not_stated", names=", ".join(missing))
    if why := wrong([v for v, _ in fields.values()]):
        return why
    out = [key for key in fields if key[0] == "E" and fields[key][0]]
    if out and not joints:
        return message("robot_programs.where_robot_workpiece_then", axis=out[0], value=fields[out[0]][0])
    frames = {}
    for m in _FRAME.finditer(text, start, stop):
        own = m[2] if m[2].isdecimal() else next(iter(current[m[1]])) if len(current[m[1]]) == 1 else ""
        if not own.isdecimal() and not joints:
            return message("robot_programs.of_controller", name=m[1])
        frames[m[1]] = f"{m[1]}[{int(own)}]" if own.isdecimal() else ""
    if set(frames) != {"UF", "UT"} and not joints:
        return message("robot_programs.not_stated", names="UF, UT")
    config = _CONFIG.search(text, start, stop)
    if config is None and not joints and text.find("CONFIG", start, stop) >= 0:
        return message("robot_programs.other_config")
    flags = {} if config is None else {"flip": int(config[1] == "F"), "up": int(config[2] != "D"), "front": int(config[3] == "T")}
    flags |= {} if config is None else {f"turn{i}": int(config[3 + i]) for i in (1, 2, 3)}
    values, spans = zip(*(fields[key] for key in wanted), strict=True)
    reported = Target(name, k, source.line(span[0]), joints, values, spans, frames.get("UF", ""), frames.get("UT", ""), flags)
    if not both:
        return [reported]
    axes, places = zip(*(fields[key] for key in AXES), strict=True)
    return [replace(reported, near=axes, taught=True), replace(reported, joints=True, values=axes, spans=places, flags={})]


def _sections(text: str) -> tuple[Span, Span]:
    """Places of the instructions and of the positions; remarks stay in, since their lines begin with !."""
    begin, positions, end = (re.search(rf"^/{name}\b", text, re.M) for name in ("MN", "POS", "END"))
    last = end.start() if end else len(text)
    middle = positions.start() if positions else last
    return (begin.end() if begin else 0, middle), (middle, last)


def _configured(flags: Mapping[str, int], degrees: FloatArray, arm: tuple[bool, bool] | None, _: float) -> bool:
    """Compare whole turns of axes 4, 5, 6 or 1, 4, 6, as the controller is set ($TURN_AXIS), T in front of the first axis, and U with the
    elbow up. It is not known which way axis 5 counts for N and F."""
    if "turn1" not in flags:
        return True
    whole = np.sign(degrees) * ((np.abs(degrees) + 180.0) // 360.0)
    stated = [flags[f"turn{k}"] for k in (1, 2, 3)]
    turns = any(np.array_equal(whole[list(axes)], stated) for axes in ((3, 4, 5), (0, 3, 5)))
    return turns and (arm is None or (not bool(flags["front"]), bool(flags["up"])) == arm)


DIALECT = Dialect("fanuc", read, _pose, _numbers, math.radians(1.0), (3, 3, 3), suffixes=(".ls",), configured=_configured)
