"""Structures drawn as in the thesis: the platform's points above, the base's below, and the links between them."""

import math
from collections.abc import Sequence
from itertools import permutations

from lmeasure.linkages import Structure

WIDTH, HEIGHT = 190.0, 150.0
BELOW = 8.0  # for the letter under the nearest point
BASE_INK, PLATFORM_INK, LINK_INK, WARN = "#1f2933", "#1d4ed8", "#8a94a0", "#c2410c"
Place = tuple[float, float]


def drawing(structure: Structure) -> str:
    """A structure as SVG of WIDTH by HEIGHT: larger dots where more links meet, the links of such a point in one colour."""
    below = _ring(len(structure.degrees[1]), HEIGHT - 38.0, 72.0, 26.0)
    above = _ring(len(structure.degrees[0]), 40.0, 50.0, 18.0)
    order = _untangled(structure, above, below)
    top = [above[i] for i in order]
    parts = [_polygon(below, "#eef1f4", BASE_INK), _polygon(top_in_ring(top, above), "#dbe7ff", PLATFORM_INK)]
    for p, b in structure.links:
        (x, y), (u, v) = top[p], below[b]
        parts.append(f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{u:.1f}" y2="{v:.1f}" stroke="{LINK_INK}" stroke-width="2"/>')
    for places, side, ink in ((top, 0, PLATFORM_INK), (below, 1, BASE_INK)):
        for i, (x, y) in enumerate(places):
            degree = structure.degrees[side][i]
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{2.0 + 1.5 * degree:.1f}" fill="{ink}"/>')
            if side == 1:
                parts.append(f'<text x="{x:.1f}" y="{y + 15.0:.1f}" font-size="11" text-anchor="middle" fill="{ink}">{"abcdef"[i]}</text>')
    return "".join(parts)


def top_in_ring(top: Sequence[Place], ring: Sequence[Place]) -> list[Place]:
    """The places in the order of the ring, so that their outline does not cross itself."""
    return sorted(top, key=list(ring).index)


def _ring(count: int, y: float, wide: float, high: float) -> list[Place]:
    """So many places on an ellipse seen from above and aside."""
    turns = [math.pi * (0.5 + 2.0 * i / count) + 0.35 for i in range(count)]
    return [(WIDTH / 2.0 + wide * math.cos(t), y + high * math.sin(t)) for t in turns]


def _untangled(structure: Structure, above: Sequence[Place], below: Sequence[Place]) -> tuple[int, ...]:
    """Return the place in the ring of each point of the platform that makes the links short in all."""

    def long(order: tuple[int, ...]) -> float:
        return sum(math.dist(above[order[p]], below[b]) for p, b in structure.links)

    return min(permutations(range(len(above))), key=long)


def _polygon(places: Sequence[Place], fill: str, ink: str) -> str:
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
    return f'<polygon points="{points}" fill="{fill}" stroke="{ink}" stroke-width="1"/>'


def svg(structure: Structure) -> str:
    """A picture of its own, for a page."""
    high = HEIGHT + BELOW
    return f'<svg viewBox="0 0 {WIDTH:g} {high:g}" width="{WIDTH:g}" height="{high:g}" aria-hidden="true">{drawing(structure)}</svg>'


def sheet(structures: Sequence[Structure], captions: Sequence[Sequence[str]], columns: int = 6) -> str:
    """All structures in one SVG picture, captions under each."""
    row = HEIGHT + 56.0
    rows = math.ceil(len(structures) / columns)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {columns * WIDTH:g} {rows * row:g}" font-family="system-ui, sans-serif">',
        f'<rect width="{columns * WIDTH:g}" height="{rows * row:g}" fill="white"/>',
    ]
    for n, (structure, lines) in enumerate(zip(structures, captions, strict=True)):
        x, y = n % columns * WIDTH, n // columns * row
        parts.append(f'<g transform="translate({x:g} {y:g})">{drawing(structure)}')
        for k, words in enumerate(lines):
            ink = WARN if structure.degenerate else BASE_INK
            at = f'x="{WIDTH / 2.0:g}" y="{HEIGHT + 14.0 + 15.0 * k:g}"'
            parts.append(f'<text {at} font-size="{12 if k == 0 else 11}" text-anchor="middle" fill="{ink}">{words}</text>')
        parts.append("</g>")
    return "\n".join([*parts, "</svg>", ""])
