"""Draw the guides and drums of a rig to their own angles and proportions, on a page beside the text of its file."""

import math
from pathlib import Path

from markupsafe import Markup

from lmeasure.report import html
from lmeasure.report.drawings import GREEN, INK, RED, SOFT, _line, _svg, _text
from lmeasure.rig import ObservationPoint, Rig
from lmeasure.text import Say

WIDE, HIGH, ARM, ARC = 720.0, 256.0, 80.0, 34.0
SMALL, LARGE = 11.0, 14.0


def write_rig_page(path: Path, rig: Rig, text: str, language: str) -> None:
    """Write a self-contained page with a drawing of each observation point and the text of rig.toml, whole or not at all."""
    say = Say(language)
    picture = Markup("").join(html.themed(guide_drawing(point)) for point in rig.observation_point)
    html.write_page(
        path, "inspection.html", html.Answer(rig.name, say("rig_page.what"), "", (), "", (), picture), say, text=text, blocks=[]
    )


def guide_drawing(point: ObservationPoint) -> str:
    """Return an SVG with the guide from the side and from above, and the path from drum to fixed pulley; keys are those of rig.toml."""
    alpha, beta, drum = math.radians(point.guide_alpha_deg), math.radians(point.guide_beta_deg), point.drum
    parts = [_text(12, 22, LARGE, point.name)]
    # from the side: the path from B to the fixed pulley, downwards
    b = (150.0, 80.0)
    parts += _angle(b, (-1.0, 0.0), -alpha, f"guide_alpha_deg {point.guide_alpha_deg:g}")
    # from above: +Y upwards, +X to the right
    c = (360.0, 130.0)
    parts += _angle(c, (0.0, -1.0), beta, f"guide_beta_deg {point.guide_beta_deg:g}")
    parts += [
        _text(c[0] + 4, c[1] - ARM - 6, SMALL, "+Y"),
        _line([c, (c[0] + 30, c[1])], SOFT, 1.0),
        _text(c[0] + 33, c[1] + 14, SMALL, "+X"),
    ]
    # drum and fixed pulley: the tangent across the drum's axis, the offset along it, in proportion
    across, along = drum.tangent_length_mm, drum.axial_offset_mm
    scale = 150.0 / max(across, abs(along), 1e-9)
    e, h = (530.0, 150.0), (530.0 + scale * across, 150.0)
    p = (e[0], e[1] - scale * along)
    parts += [_line([e, h], SOFT, 1.2, 'stroke-dasharray="5 4"'), _line([e, p], SOFT, 1.2), _line([p, h], RED, 2.4), _dot(h), _dot(p)]
    wound = [(p[0] - 6, min(e[1], p[1]) - 26), (p[0] - 6, max(e[1], p[1]) + 12)]
    parts.append(_line(wound, INK, 8.0))
    values = [f"{key} {getattr(drum, key):g}" for key in ("tangent_length_mm", "axial_offset_mm", "groove_pitch_mm", "count_length_mm")]
    values += [f"counts_per_revolution {drum.counts_per_revolution}", f"pulley_radius_mm {point.pulley_radius_mm:g}"]
    parts += [_text(520, 176 + 14 * i, SMALL, value) for i, value in enumerate(values)]
    return _svg((0.0, 0.0, WIDE, HIGH), "".join(parts), point.name)


def _dot(at: tuple[float, float]) -> str:
    return f'<circle cx="{at[0]:.2f}" cy="{at[1]:.2f}" r="4" fill="{INK}"/>'


def _angle(at: tuple[float, float], zero: tuple[float, float], turn: float, label: str) -> list[str]:
    """Return an angle at B: the direction of zero, the one turned from it clockwise on the page, the arc between and its name."""
    (x, y), (u, v) = at, zero

    def turned(angle: float, length: float) -> tuple[float, float]:
        return x + length * (u * math.cos(angle) - v * math.sin(angle)), y + length * (u * math.sin(angle) + v * math.cos(angle))

    arc = [turned(turn * i / 24, ARC) for i in range(25)]
    zero_line = _line([at, turned(0.0, ARM)], SOFT, 1.2, 'stroke-dasharray="5 4"')
    return [
        zero_line,
        _line(arc, GREEN, 1.6),
        _line([at, turned(turn, ARM)], RED, 2.4),
        _dot(at),
        _text(x + 6, y - 6, SMALL, "B"),
        _text(x, HIGH - 44, SMALL, label, "middle"),
    ]
