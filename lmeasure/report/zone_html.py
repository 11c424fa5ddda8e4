"""The zone on a page: one self-contained HTML file."""

from collections.abc import Sequence
from pathlib import Path

import xarray as xr

from lmeasure.accuracy import extent
from lmeasure.report import html, zone_text
from lmeasure.report.structure import slices_figure
from lmeasure.report.zone_faults import faults
from lmeasure.report.zone_figures import space_figure
from lmeasure.report.zone_maps import maps
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.structure import Piece, one_limit
from lmeasure.text import Say


def write_zone_page(
    path: Path,
    zone: xr.Dataset,
    rig: Rig,
    calibration: CalibrationRecord | None = None,
    *,
    language: str = "en",
    followed: Sequence[Piece] = (),
) -> None:
    """Write a self-contained HTML page: what was found, the zone in space, its maps, figures, reasons, the rig. calibration: that of the
    zone; followed: its edge at every level."""
    found, say = extent(zone), Say(language)
    exact = "".join(html.paragraph(line, "small") for line in zone_text.taken_as_exact(zone, say))
    body = [
        *(html.paragraph(line) for line in zone_text.findings(zone, found, say)),
        html.heading(say("zone.zone_space")),
        html.paragraph(_in_space(zone_text.has_edge(zone), say)),
        html.figure(space_figure(zone, rig, say, followed), "space", first=True, language=language),
        html.heading(say("zone.level_level")),
        html.paragraph(say("zone.white_line_edge_zone")),
        *maps(zone, rig, calibration, say),
        *_edge(followed, say),
        *faults(zone, say),
        *(
            part
            for title, header, rows in zone_text.tables(zone, found, rig, say)
            for part in (html.heading(title), html.table(header, rows))
        ),
        *([html.heading(say("zone.not_95_radius")), exact] if exact else []),
        *(
            html.paragraph(say("zone.nobody_measured_these_values", names=", ".join(rig.assumed)), "warning")
            for _ in range(bool(rig.assumed))
        ),
    ]
    html.write_page(path, zone_text.title(rig, say), body, language)


def _in_space(edge: bool, say: Say) -> str:
    """What is seen of the zone in space, with its edge or without."""
    if edge:
        return say("zone.drag_turn_scroll_come_nearer")
    return say("zone.drag_turn_scroll_come")


def _edge(followed: Sequence[Piece], say: Say) -> list[str]:
    """The edge as it was followed, drawn from above and reported level by level."""
    if not followed:
        return []
    drawn, rows = [], []
    for piece in followed:
        limits = [one_limit(limit) for limit in piece.limits]
        drawn.append(piece.as_dict() | {"limits": limits})
        size = say("page.open") if piece.area_mm2 is None else f"{say('page.closed')}, {piece.area_mm2 / 1e6:.4g}"
        rows.append((f"{piece.level_mm:g}", size, ", ".join(say.message(limit) for limit in dict.fromkeys(limits))))
    words = say("zone.followed_not_read_off")
    return [
        html.heading(say("zone.edge_followed")),
        html.paragraph(words),
        html.figure(slices_figure({"plane": "xy", "slices": drawn}, None, say), "followed", first=False, language=say.language),
        html.table((say("zone.level_mm_2"), say("zone.edge_m"), say("zone.limits_met")), rows),
    ]
