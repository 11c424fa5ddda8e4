"""Readers of RAPID, FANUC listings and tables for the tests, word by word, which share no code with lmeasure: by source and place of its
first number, what is moved to: flange poses (4, 4), None in a frame that is not known, or joint values, with the target's flags."""

import csv
import io
import re
from collections import defaultdict
from typing import Any

import numpy as np
from program_words import Met, abc, numbered, quaternion, wpr


def rapid(text: str, frames: dict[str, np.ndarray]) -> Met:
    """Declarations of the routine before those of the module; what is assigned, passed, searched for or computed is none."""
    plain = "\n".join(line for _, line in numbered(text.replace("\r", " "), "!", '"'))
    assert len(plain) == len(text)
    met: Met = defaultdict(list)
    at_frames = dict(frames) | {"wobj0": np.eye(4), "tool0": np.eye(4)}
    points: dict[tuple[str, str], tuple[int, Any]] = {}
    lost: set[str] = set()

    def values(at: int) -> tuple[Any, int]:
        """A list of lists of (number, place), and what stands behind it."""
        while plain[at].isspace():
            at += 1
        if plain[at] != "[":
            end = min(plain.index(c, at) for c in ",]" if plain.find(c, at) >= 0)
            return (float(plain[at:end].strip() or "nan") if re.search(r"\d", plain[at:end]) else plain[at:end].strip(), at), end
        out, at = [], at + 1
        while True:
            one, at = values(at)
            out.append(one)
            while plain[at].isspace():
                at += 1
            if plain[at] == "]":
                return out, at + 1
            at += 1

    def pose(parts: Any) -> np.ndarray:
        return quaternion([v for v, _ in parts[0]], [v for v, _ in parts[1]])

    where: list[tuple[int, str]] = [(0, "")]
    for m in re.finditer(r"\b(?:PROC|TRAP|FUNC\s+\w+)\s+(\w+)|\bEND(?:PROC|TRAP|FUNC)\b", plain, re.I):
        where.append((m.start(), (m[1] or "").lower()))

    def routine(at: int) -> str:
        return [name for start, name in where if start <= at][-1]

    for m in re.finditer(r"\b(robtarget|jointtarget|tooldata|wobjdata)\s+(\w+)\s*(\{.*?\})?:=", plain):
        if m[3]:
            continue
        found, _ = values(m.end())
        if m[1] == "tooldata" and found[0][0] == "TRUE":
            at_frames[m[2].lower()] = pose(found[1])
        elif m[1] == "wobjdata" and (found[0][0], found[1][0]) == ("FALSE", "TRUE"):
            at_frames[m[2].lower()] = pose(found[3]) @ pose(found[4])
        elif m[1] in ("robtarget", "jointtarget"):
            points[routine(m.start()), m[2].lower()] = m.start(), found
    for m in re.finditer(r"(?m)^\s*(\w+)(?:\.\w+)*:=", plain):
        lost.add(m[1].lower())
        at_frames.pop(m[1].lower(), None)
    for statement in re.finditer(r"[^;]*;", plain):
        move = re.search(r"\b(Move(?:AbsJ|LDO|J|L|C)|Trigg[JLC]|SearchL|ArcLStart|Touch)\b\s*", statement[0], re.I)
        if move is None:
            continue
        at, kind = statement.start() + move.end(), move[1].lower()
        operands: list[tuple[int, str]] = [(at, "")]
        depth = 0
        for i, c in enumerate(statement[0][move.end() : -1]):
            depth += (c in "[({") - (c in "])}")
            if c == "," and depth == 0:
                operands.append((at + i + 1, ""))
            else:
                operands[-1] = operands[-1][0], operands[-1][1] + c
        words = [(a + len(t) - len(t.lstrip()), t.split("\\")[0].strip().lower()) for a, t in operands if t.strip()[:1] not in ("\\", "")]
        if kind.startswith(("search", "touch", "arcl")):
            lost |= {w for _, w in words[:2]}
            words = words[2:] if kind.startswith("search") else []
        count = 2 if kind.startswith(("movec", "triggc")) else 1
        tool = words[count + (1 if kind.startswith("search") else 3 if kind.startswith("trigg") else 2)][1] if words else ""
        wobj = re.search(r"\\WObj:=(\w+)", statement[0], re.I)
        for at, word in words[:count]:
            of = points.get((routine(at), word)) or points.get(("", word))
            found = values(at)[0] if word.startswith("[") else None if of is None or word in lost else of[1]
            if found is None:
                continue
            place, numbers = (("", found[0][0][1]), [v for part in found for v, _ in part])
            if len(found) == 2:
                met[place].append((numbers[:6], {}))
                continue
            base, tip = at_frames.get(wobj[1].lower() if wobj else "wobj0"), at_frames.get(tool)
            sound = abs(np.linalg.norm(numbers[3:7]) - 1.0) < 1e-3 and all(v == 9e9 for v in numbers[-6:])
            flags = dict(zip(("cf1", "cf4", "cf6", "cfx"), map(int, numbers[7:11]), strict=True))
            if base is None or tip is None or not sound:
                met[place].append((None, flags))
            else:
                met[place].append((base @ pose(found[:2]) @ np.linalg.inv(tip), flags))
    return {place: [(None, {})] if _is_lost(place[1], points, lost) else every for place, every in met.items()}


def _is_lost(at: int, points: dict[tuple[str, str], tuple[int, Any]], lost: set[str]) -> bool:
    return any(name in lost and found[0][0][1] == at for (_, name), (_, found) in points.items())


def fanuc(text: str, frames: dict[str, np.ndarray]) -> Met:
    """Positions that a motion takes without any of the words that move it elsewhere."""
    at_frames = dict(frames) | {"UF0": np.eye(4)}
    program, positions = text.split("/MN")[1].split("/POS")
    start = text.index("/POS") + 4
    used: set[int] = set()
    bad: set[int] = set()
    for statement in program.replace("\r", "").split(";"):
        body = re.sub(r"\n\s*:", " ", statement.strip("\n ")).partition(":")[2]
        numbers = [int(n) for n in re.findall(r"(?<!\w)P\[(\d+)", body)]
        if body[:2] in ("J ", "L ", "C ", "A "):
            elsewhere = any(word in body for word in ("Offset", "INC", "COORD", "RTCP"))
            (bad if elsewhere else used).update(numbers)
        elif re.match(r"\s*P\[\d+\]=", body):
            bad.add(numbers[0])
    set_here = {f"U{m[1]}{m[2]}" for m in re.finditer(r":\s*U(F|T)(?:RAME|OOL)\[(\d+)\]=", program)}
    met: Met = defaultdict(list)
    for m in re.finditer(r"P\[(\d+)[^\]]*\]\{(.*?)\};", positions, re.S):
        if int(m[1]) not in used - bad or "*" in m[2]:
            continue
        fields = {f[1]: (float(f[2]), start + m.start(2) + f.start(2)) for f in re.finditer(r"\b([XYZWPR]|[JE]\d)\s*=\s*([-\d.]+)", m[2])}
        if "J1" in fields:
            met["", fields["J1"][1]].append(([fields[f"J{i}"][0] for i in range(1, 7)], {}))
            continue
        names = [f"U{w[0]}{w[1]}" for w in re.findall(r"U(F|T) : (\w+)", m[2])]
        known = all(n in at_frames and n not in set_here for n in names) and not fields.get("E1", (0.0,))[0]
        letters, *turns = m[2].split("'")[1].split(",")
        flags = {"flip": int(letters[0] == "F"), "up": int("U" in letters), "front": int("T" in letters)}
        flags |= {f"turn{i + 1}": int(t) for i, t in enumerate(turns)}
        pose = at_frames[names[0]] @ wpr([fields[k][0] for k in "XYZWPR"]) @ np.linalg.inv(at_frames[names[1]]) if known else None
        met["", fields["X"][1]].append((pose, flags))
    return met


def table(text: str, columns: tuple[str, ...], separator: str, decimal: str) -> dict[str, np.ndarray]:
    """By name, poses of rows that are whole, through Python's own reader."""
    rows = [r for r in csv.reader(io.StringIO(text), delimiter=separator) if r and not r[0].startswith("#")]
    places = [rows[0].index(c) for c in columns]
    out = {}
    for row in rows[1:]:
        try:
            values = [float(row[i].replace(decimal, ".")) for i in places]
        except ValueError:
            continue
        if len(row) == len(rows[0]) and np.abs(values).max() < 1e6:
            out[row[0]] = (abc if columns[3].startswith("a") else wpr)(values)
    return out
