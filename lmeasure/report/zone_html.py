"""Values of a zone's page: its best and worst positions with reasons, ways to enlarge it, maps and tables."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from lmeasure.accuracy import VARIABLES, Extent, ellipsoids, extent, messages_of, sole_reasons
from lmeasure.report import html, zone_text
from lmeasure.report.figures import figure
from lmeasure.report.structure import slices_figure
from lmeasure.report.zone_figures import faults_figure, fullest_level, space_figure, u95_figure
from lmeasure.report.zone_maps import maps
from lmeasure.report.zone_pdf import write_zone_pdf
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.structure import Piece, one_limit
from lmeasure.text import Say

OPTIONS = {
    "pressure_angle": "--limit-deg",
    "u95_position": "--u95-mm",
    "u95_rotation": "--u95-rotation-deg",
    "u95_attachment": "--u95-attachment-mm",
}
"""Options of `lmeasure zone` that move a limit."""


def write_zone_report(
    folder: Path,
    zone: xr.Dataset,
    rig: Rig,
    calibration: CalibrationRecord | None = None,
    *,
    language: str = "en",
    followed: Sequence[Piece] = (),
) -> None:
    """Write zone.html and zone.pdf into the folder, each whole or not at all; calibration: that of the zone; followed: its edge, level by
    level, for the page."""
    write_zone_page(Path(folder) / "zone.html", zone, rig, calibration, language=language, followed=followed)
    write_zone_pdf(Path(folder) / "zone.pdf", zone, rig, language)


def write_zone_page(
    path: Path,
    zone: xr.Dataset,
    rig: Rig,
    calibration: CalibrationRecord | None = None,
    *,
    language: str = "en",
    followed: Sequence[Piece] = (),
) -> None:
    """Write a self-contained HTML page: results, the zone in space, its maps, figures, reasons, the rig. calibration: that of the zone;
    followed: its edge at every level."""
    found, say = extent(zone), Say(language)
    plots = {"space": figure(space_figure(zone, rig, say, followed), "space", language)}
    if followed:
        pieces = [piece.as_dict() | {"limits": [one_limit(limit) for limit in piece.limits]} for piece in followed]
        plots["followed"] = figure(slices_figure({"plane": "xy", "slices": pieces}, None, say), "followed", language)
    if VARIABLES[0] in zone and zone["in_zone"].values.any():
        plots["faults"] = figure(faults_figure(zone, say), "faults", language)
    html.write_page(
        path, "zone.html", answer(path.parent.name, zone, found, rig=rig, calibration=calibration, say=say), say,
        findings=zone_text.findings(zone, found, say), unstated=zone_text.assumed(zone, say), edge=zone_text.has_edge(zone),
        maps=maps(zone, rig, calibration, say), plots=plots, followed=[_edge(piece, say) for piece in followed],
        fault_rows=_fault_rows(zone, say) if "faults" in plots else [], z=float(zone["z"].values[fullest_level(zone)]),
        tables=zone_text.tables(zone, found, rig, say), assumed=", ".join(rig.assumed),
    )  # fmt: skip


def answer(folder: str, zone: xr.Dataset, found: Extent, *, rig: Rig, calibration: CalibrationRecord | None, say: Say) -> html.Answer:
    """Return the first screen: best and worst U95, position and reason, the volume and ways to enlarge it, and the next step."""
    inside, attrs = zone["in_zone"].values.astype(bool), zone.attrs
    again = "lmeasure zone RIG.toml --x ... --y ... --z ... --out zone.nc --report zone"
    reason, nodes = max(sole_reasons(zone).items(), key=lambda item: item[1])
    larger = say("zone.larger_nothing")
    if nodes:
        volume = nodes * float(np.prod(attrs["node_spacing_mm"])) / 1e9
        larger = say(
            "zone.larger" if reason in OPTIONS else "zone.larger_geometry", reason=zone_text.reason_words(say)[reason], volume=volume
        )
    place = html.Step(say("zone.next_place"), "lmeasure place RIG.toml --task placement.toml --out placed")
    use = html.Step(say("zone.next_measure"), "lmeasure record RIG.toml --bus INTERFACE:CHANNEL --out run1")
    wider = [html.Step(say("zone.next_larger"), f"{again} {OPTIONS[reason]} LIMIT")] if nodes and reason in OPTIONS else []
    rows: tuple[html.Number, ...] = ()
    if inside.any():
        u95 = np.where(inside, zone["u95_position_mm"].values, np.nan)
        at = [np.unravel_index(int(pick(u95)), u95.shape) for pick in (np.nanargmin, np.nanargmax)]
        best, worst = (float(u95[i]) for i in at)
        where = [np.array([float(zone[name].values[k]) for name, k in zip("xyz", i, strict=True)]) for i in at]
        state, verdict = "good", say("zone.verdict", worst=worst, volume=found.volume_mm3 / 1e9)
        if attrs["assemblies_in_zone"] > 1:
            state, verdict = "warn", say("zone.zone_holds_more_than")
        rows = tuple(
            html.Number(say(f"zone.u95_{name}"), say("zone.in_mm", mm=mm), say("zone.at_place", place=say.numbers(here, "g")))
            for name, mm, here in (("best", best, where[0]), ("worst", worst, where[1]))
        )
        rows += html.assumed_numbers(messages_of(zone, "assumed"), say)
        rows += (
            html.Number(
                say("zone.volume"), say("zone.m", m3=found.volume_mm3 / 1e9), say("zone.volume_note", error=found.volume_error_mm3 / 1e9)
            ),
        )
        turns = zone["quaternion_xyzw"].values
        start = np.array(attrs["zero_pose_xyz_mm_qxyzw"], dtype=np.float64)
        seen = ellipsoids(rig, calibration, where[1][None, :], Rotation.from_quat(turns[len(turns) // 2]), start=start)
        cable = rig.cable[int(seen.weakest[0])].name
        limits = say("zone.limited", cable=cable, angle=float(seen.angle_deg[0])) + " " + larger
        steps: tuple[html.Step, ...] = (use, *(wider or [place]))
    else:
        best = float(zone["worst_pressure_angle_deg"].min())
        state, verdict, limits, steps = "bad", say("zone.no_place_lies_zone", best=best), larger, (place, *wider)
        rows = (html.Number(say("zone.volume"), say("zone.m", m3=0.0)), html.Number(say("zone.best_angle"), f"{say.number(best, '.1f')}°"))
    nodes_turns = say("zone.subject", nodes=zone["in_zone"].size, turns=zone.sizes["orientation"], limit=float(attrs["limit_deg"]))
    return html.Answer(
        zone_text.title(rig, say), verdict, state, rows, limits, steps,
        figure(u95_figure(zone, say), "u95-level", say.language, hero=True), nodes_turns,
        say("zone.u95_level", z=float(zone["z"].values[fullest_level(zone)])),
    )  # fmt: skip


def _edge(piece: Piece, say: Say) -> tuple[str, ...]:
    """Return level, area and limits of a piece of the edge."""
    size = say("page.open") if piece.area_mm2 is None else f"{say('page.closed')}, {say.number(piece.area_mm2 / 1e6, '.4g')}"
    limits = dict.fromkeys(one_limit(limit) for limit in piece.limits)
    return say.number(piece.level_mm, "g"), size, ", ".join(say.message(limit) for limit in limits)


def _fault_rows(zone: xr.Dataset, say: Say) -> list[tuple[str, ...]]:
    inside = zone["in_zone"].values.astype(bool)
    rows = []
    for k, name in enumerate(zone["channel"].values):
        unit = "°" if zone["channel_unit"].values[k] == "degree" else say("zone.mm")
        values = [zone[v].values[inside][:, k] for v in VARIABLES]
        rows.append((str(name), *(_span(v, u, say) for v, u in zip(values, (unit, unit, ""), strict=True))))
    return rows


def _span(values: np.ndarray, unit: str, say: Say) -> str:
    low, high = float(values.min()), float(values.max())
    if not np.isfinite(low):
        return say("page.none")
    best = say.number(low, ".3g")
    return f"{best}\u00a0… {say.number(high, '.3g')}{unit}" if np.isfinite(high) else say("zone.none", best=best + unit)
