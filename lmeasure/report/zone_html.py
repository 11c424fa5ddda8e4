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
from lmeasure.structure import Piece
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
        html.heading(say("The zone in space")),
        html.paragraph(_in_space(zone_text.has_edge(zone), say)),
        html.figure(space_figure(zone, rig, say, followed), "space", first=True, language=language),
        html.heading(say("Level by level")),
        html.paragraph(
            say(
                "The white line is the edge of the zone within the limits of the sliders. Click a place: below stand its figures, the "
                "ellipsoid that holds 95 % of its measured positions, and the direction of the cable with the largest pressure angle "
                "(orange)."
            )
        ),
        *maps(zone, rig, calibration, say),
        *_edge(followed, say),
        *faults(zone, say),
        *(
            part
            for title, header, rows in zone_text.tables(zone, found, rig, say)
            for part in (html.heading(title), html.table(header, rows))
        ),
        *([html.heading(say("Not in the 95 % radius")), exact] if exact else []),
        *(
            html.paragraph(say("Nobody measured these values: {names}.", names=", ".join(rig.assumed)), "warning")
            for _ in range(bool(rig.assumed))
        ),
    ]
    html.write_page(path, zone_text.title(rig, say), body, language)


def _in_space(edge: bool, say: Say) -> str:
    """What is seen of the zone in space, with its edge or without."""
    if edge:
        return say(
            "Drag to turn, scroll to come nearer. The orange surface is the edge of the zone; the slider moves a plane through it, "
            "coloured by the worst pressure angle. Lines are the cables with the tool in the middle of the box."
        )
    return say(
        "Drag to turn, scroll to come nearer. The slider moves a plane through the box, coloured by the worst pressure angle. Lines are "
        "the cables with the tool in the middle of the box."
    )


def _edge(followed: Sequence[Piece], say: Say) -> list[str]:
    """The edge as it was followed, drawn from above and told level by level."""
    if not followed:
        return []
    drawn, rows = [], []
    for piece in followed:
        limits = [limit.split(" in orientation")[0] for limit in piece.limits]
        drawn.append(piece.as_dict() | {"limits": limits})
        size = say("open") if piece.area_mm2 is None else f"{say('closed')}, {piece.area_mm2 / 1e6:.4g}"
        rows.append((f"{piece.level_mm:g}", size, ", ".join(say.told(limit) for limit in dict.fromkeys(limits))))
    words = say("Followed, not read off the nodes: each line is on the limit to rounding, in the colour of the limit that is met there.")
    return [
        html.heading(say("The edge, followed")),
        html.paragraph(words),
        html.figure(slices_figure({"plane": "xy", "slices": drawn}, None, say), "followed", first=False, language=say.language),
        html.table((say("level, mm"), say("edge, m²"), say("limits met")), rows),
    ]
