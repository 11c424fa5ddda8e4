"""What the tests' own readers of programs have in common: poses of angles, quaternions and rotation vectors; lines without remarks."""

from typing import Any

import numpy as np
from programs import about, homogeneous

Met = dict[tuple[str, int], list[tuple[Any, dict[str, int]]]]


def abc(values: list[float]) -> np.ndarray:
    x, y, z, a, b, c = values
    return homogeneous([x, y, z], about(2, a) @ about(1, b) @ about(0, c))


def wpr(values: list[float]) -> np.ndarray:
    return abc([*values[:3], values[5], values[4], values[3]])


def quaternion(place: list[float], q: list[float]) -> np.ndarray:
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return homogeneous(place, np.eye(3) + 2 * w * cross + 2 * cross @ cross)


def vector(values: list[float]) -> np.ndarray:
    angle = float(np.linalg.norm(values[3:]))
    x, y, z = np.array(values[3:]) / (angle or 1.0)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return homogeneous([1000 * v for v in values[:3]], np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k)


def without(line: str, comment: str, quotes: str, fill: str) -> str:
    """A line with its comment as blanks, its strings as another sign."""
    out, quote = "", ""
    for i, c in enumerate(line):
        if quote:
            quote = "" if c == quote else quote
            out += fill
        elif c in comment:
            return out + " " * (len(line) - i)
        else:
            quote = c if c in quotes else ""
            out += fill if quote else c
    return out


def numbered(text: str, comment: str, quotes: str, fill: str = " ") -> list[tuple[int, str]]:
    """Lines with the places that they begin at."""
    out, at = [], 0
    for line in text.split("\n"):
        out.append((at, without(line.rstrip("\r"), comment, quotes, fill)))
        at += len(line) + 1
    return out
