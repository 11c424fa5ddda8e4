"""Shapes of new rigs, and the values that users can change."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from lmeasure.rig import Rig, rig_from_dict
from lmeasure.text import Message, message

Vector = tuple[float, float, float]

HALF_MM = 300.0
"""Half the edge of the cube about the base frame's origin that every template serves."""
TILT_RAD = 0.2
"""And the largest component of the rotation vectors there."""
DRUM = {
    "counts_per_revolution": 6000,
    "count_length_mm": 0.012,
    "groove_pitch_mm": 1.0,
    "tangent_length_mm": 180.0,
    "axial_offset_mm": 25.0,
}
PULLEY_RADIUS_MM = 20.0
GUIDE_ALPHA_DEG = 50.0
GUESSED = ("pulley_radius_mm", "tangent_length_mm", "axial_offset_mm")
"""Values that differ from rig to rig, so that no template can know them."""


@dataclass(frozen=True)
class Template:
    """Observation points [mm, base frame], attachment points [mm, tool frame], and which cable runs between which: (point, attachment
    point, pass)."""

    text: Message
    points: tuple[Vector, ...]
    tool: tuple[Vector, ...]
    cables: tuple[tuple[int, int, int], ...]


def _around(radius: float, *azimuths_deg: float, z: float = 0.0) -> tuple[Vector, ...]:
    return tuple((radius * math.cos(math.radians(a)), radius * math.sin(math.radians(a)), z) for a in azimuths_deg)


def _rounded(points: tuple[Vector, ...]) -> tuple[Vector, ...]:
    return tuple((round(x, 1) + 0.0, round(y, 1) + 0.0, round(z, 1) + 0.0) for x, y, z in points)


TEMPLATES = {
    "six-cables": Template(
        message("template.six_cables"),
        # as the simulated cell: found by a search over places outside a cube of 1400 mm
        ((860, 0, 2020), (-1110, 160, 670), (-1010, 1940, -220), (-240, 360, 2150), (-330, -770, 2030), (-1140, -1570, -590)),
        _rounded(_around(150.0, 90, 210, 330)),
        ((1, 1, 1), (2, 1, 1), (3, 2, 1), (4, 2, 1), (5, 3, 1), (6, 3, 1)),
    ),
    "eight-cables": Template(
        message("template.eight_cables"),
        (
            (-1200, -1150, 1300), (-1200, 1150, 1300), (1200, -1150, 1300), (1200, 1150, 1300),
            (-1200, -1150, -700), (-1200, 1150, -700), (1200, -1150, -700), (1200, 1150, -700),
        ),
        ((106.0, 106.0, 60.0), (-106.0, 106.0, -60.0), (-106.0, -106.0, 60.0), (106.0, -106.0, -60.0)),
        ((1, 3, 1), (2, 1, 1), (3, 2, 1), (4, 4, 1), (5, 1, 1), (6, 3, 1), (7, 4, 1), (8, 2, 1)),
    ),
    "three-drums": Template(
        message("template.three_drums"),
        ((-940, 1440, 1310), (410, 740, -1420), (-1040, 70, -1330)),
        _rounded(_around(150.0, 90, 210, 330)),
        ((1, 1, 1), (2, 2, 1), (3, 3, 1), (1, 2, 2), (2, 3, 2), (3, 1, 2)),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Answers:
    """Answers of a person about the rig; missing ones are the template's. positions, tool: by the names B1, ... and P1, ..."""

    name: str = "my rig"
    angles: str = "puma-oat"
    drum: Mapping[str, float] = field(default_factory=dict)
    pulley_radius_mm: float | None = None
    positions: Mapping[str, Vector] = field(default_factory=dict)
    tool: Mapping[str, Vector] = field(default_factory=dict)


def rig_of(template: Template, answers: Answers = Answers()) -> Rig:
    """The rig; RigError where an answer makes none. Guides come up from outside: the way from B to the fixed pulley leads away from the
    cell's middle and downwards."""
    radius = PULLEY_RADIUS_MM if answers.pulley_radius_mm is None else answers.pulley_radius_mm
    said = {*answers.drum, *([] if answers.pulley_radius_mm is None else ["pulley_radius_mm"])}
    points = []
    for number, place in enumerate(template.points, 1):
        x, y, z = answers.positions.get(f"B{number}", place)
        points.append(
            {
                "name": f"B{number}",
                "position_mm": [float(x), float(y), float(z)],
                "guide_alpha_deg": GUIDE_ALPHA_DEG,
                "guide_beta_deg": float(round(math.degrees(math.atan2(x, y)))),
                "pulley_radius_mm": radius,
                "drum": DRUM | dict(answers.drum),
            }
        )
    tool = {f"P{i}": [float(v) for v in answers.tool.get(f"P{i}", at)] for i, at in enumerate(template.tool, 1)}
    cables = [
        {"name": f"c{i}", "channel": f"ch{b}", "from": f"B{b}", "to": f"P{p}"} | ({"pass": n} if n > 1 else {})
        for i, (b, p, n) in enumerate(template.cables, 1)
    ]
    content = {
        "schema": "lmeasure.rig/1",
        "name": answers.name,
        "angles": answers.angles,
        "assumed": [f"{p['name']}.{key}" for p in points for key in GUESSED if key not in said],
        "observation_point": points,
        "tool": tool,
        "cable": cables,
    }
    return rig_from_dict(content, "new rig")
