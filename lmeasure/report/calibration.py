"""Values of a calibration's page: the answers of its first screen, and the rows of its tables."""

from pathlib import Path
from typing import Any

import numpy as np

from lmeasure.calibration import Calibration, Comparison, chance
from lmeasure.report import html
from lmeasure.report.calibration_figures import narrowed_figure, residuals_figure, rig_figure, spectrum_figure, worst_figure
from lmeasure.report.figures import figure
from lmeasure.rig import CalibrationRecord
from lmeasure.text import Say, decimal, settled

Rows = list[tuple[str, ...]]
HARMLESS = ("assumed_rotation", "assumed_position")
"""Warnings that only name assumed values."""


def write_calibration_page(path: Path, calibration: Calibration, comparison: Comparison | None = None, language: str = "en") -> None:
    """Write a self-contained HTML page of the calibration, and of changes since an earlier one, whole or not at all."""
    record, say = calibration.record, Say(language)
    plots = {"predicted": figure(worst_figure(calibration, say), "predicted", language)}
    if any(settled(r.mm) for r in record.residuals):  # else a drawing would show how the arithmetic was rounded
        plots["residuals"] = figure(residuals_figure(record, calibration.campaign.rig, say), "residuals", language)
    if record.spectrum:
        plots["spectrum"] = figure(spectrum_figure(record, say), "spectrum", language)
        plots["narrowed"] = figure(narrowed_figure(record, say), "narrowed", language)
    html.write_page(
        path, "calibration.html", answer(path.parent.name, calibration, comparison, say), say,
        record=record, comparison=comparison, moved=_moved(comparison, say), plots=plots, chi=_chi(record, say),
        lengths=[(e["cable"], say.number(e["rms_mm"], ".4f"), say.number(e["worst_mm"], ".4f")) for e in record.predicted["lengths"]],
        held_out=_held_out(record, say), shown=_effects_shown(record, say), coarse=_coarse(record, say),
        inputs=[(i.file, i.sha256) for i in record.inputs], harmless=HARMLESS,
    )  # fmt: skip


def answer(folder: str, calibration: Calibration, comparison: Comparison | None, say: Say) -> html.Answer:
    """Return the first screen: whether the rig may be used, its uncertainty, the largest limitation, and the next step."""
    record, refused = calibration.record, calibration.refused
    limitations = sum(w.code not in HARMLESS for w in record.warnings)
    moved = comparison is not None and comparison.moved
    if refused is not None:
        state, verdict = "bad", say("calibration.not_used", why=say.message(refused))
    elif moved:
        state, verdict = "warn", say("calibration.something_moved_beyond_uncertainties")
    elif limitations:
        state, verdict = "warn", say("calibration.calibrated_reservations_read_marked", number=limitations)
    else:
        state, verdict = "good", say("calibration.calibrated_nothing_contradicts")
    if comparison is not None and not moved:
        verdict += " " + say("calibration.nothing_moved_beyond_uncertainties")
    worst = max(record.predicted["lengths"], key=lambda e: float(e["worst_mm"]))
    limits = say("calibration.limited_cable", cable=worst["cable"], mm=worst["worst_mm"])
    if record.unobservable:
        limits = say("calibration.limited_undetermined", number=len(record.unobservable)) + " " + limits
    poses = len({r.pose for r in record.residuals})
    return html.Answer(
        say("calibration.calibration_rig", rig=record.rig), verdict, state, _numbers(record, say), limits, _steps(folder, calibration, say),
        figure(rig_figure(calibration, say), "rig", say.language, hero=True),
        say("calibration.subject", poses=poses, channels=len({r.channel for r in record.residuals})),
        say("calibration.observation_points_cables_first"),
    )  # fmt: skip


def _numbers(record: CalibrationRecord, say: Say) -> tuple[html.Number, ...]:
    def mm(value: float) -> str:
        return say("calibration.mm_rms", mm=settled(value))

    out = []
    predicted, validation, rms = record.predicted, record.validation, record.noise["residual_rms_mm"]
    if "position_rms_mm" in predicted:
        both = predicted["position_rms_mm"], predicted.get("position_worst_mm", predicted["position_rms_mm"])
        value = say("calibration.mm_from_to", low=both[0], high=both[1])
        out.append(html.Number(say("calibration.tools_place_over_workspace"), value, say("calibration.rms_worst")))
    else:
        rms_mm, worst_mm = (np.array([e[key] for e in predicted["lengths"]]) for key in ("rms_mm", "worst_mm"))
        value = say("calibration.mm_from_to", low=np.sqrt(np.mean(rms_mm**2)), high=worst_mm.max())
        out.append(html.Number(say("calibration.lengths_over_workspace"), value, say("calibration.rms_worst")))
    if "against_nominal" in validation:
        against = validation["against_nominal"]
        note = say("calibration.before_calibration", mm=against["nominal_mm"])
        worse = "bad" if against["rms_mm"] > against["nominal_mm"] else ""
        out.append(html.Number(say("calibration.lengths_poses_left_out"), mm(against["rms_mm"]), note, worse))
    if "held_out" in validation:
        held = validation["held_out"]
        note = say("calibration.expected_mm", mm=held["expected_mm"])
        out.append(html.Number(say("calibration.lengths_poses_held_out"), mm(held["rms_mm"]), note))
    out.append(html.Number(say("calibration.residuals_2"), mm(rms), _chi(record, say)))
    kept = record.unknowns - record.rank
    note = say("calibration.nominal_values", number=kept) if kept else ""
    out.append(
        html.Number(
            say("calibration.combinations_determined"), say("page.of", n=record.rank, of=record.unknowns), note, "warn" if kept else ""
        )
    )
    return tuple(out)


def _chi(record: CalibrationRecord, say: Say) -> str:
    freedom = record.noise["degrees_of_freedom"]
    if not freedom:
        return say("calibration.none_no_equation_left")
    return say("calibration.degrees_freedom", chi=record.noise["chi_squared"], freedom=freedom)


def _steps(folder: str, calibration: Calibration, say: Say) -> tuple[html.Step, ...]:
    if calibration.refused is not None:
        return (html.Step(say("calibration.next_refused"), "lmeasure plan-poses --extend FOLDER --poses 4 --out more.csv"),)
    use = html.Step(say("calibration.next_record"), f"lmeasure record {folder}/rig.toml --bus INTERFACE:CHANNEL --out run1")
    if calibration.record.unobservable:
        more = "lmeasure plan-poses --extend FOLDER --poses 4 --out more.csv"
        return html.Step(say("calibration.next_more_poses"), more), use
    zone = "lmeasure zone RIG --x -500:500:50 --y -500:500:50 --z 0:500:50 --out zone.nc --report zone"
    return use, html.Step(say("calibration.next_zone"), zone.replace("RIG", f"{folder}/rig.toml"))


def _moved(comparison: Comparison | None, say: Say) -> dict[str, Rows]:
    """Return the rows of all tables of changes, with a last column if anything is marked."""
    if comparison is None:
        return {}
    number, moved = say.number, say("page.moved")
    points: Rows = []
    for p in (*comparison.points, comparison.together):
        name = say("calibration.all") if p is comparison.together else p.point
        shift = number(p.distance_mm, ".4f"), number(p.chi_squared, ".4g"), say("page.of", n=p.freedom, of=p.values)
        points.append((name, *shift, _chance(p.probability, say), moved if p.moved else ""))
    lengths = [
        (c.cable, *(number(v, ".4f") for v in (c.rms_mm, c.worst_mm, c.u_mm)), _chance(c.probability, say), moved if c.moved else "")
        for c in comparison.lengths
    ]
    values = [(v.name, *(number(x, ".4f") for x in (v.old, v.new, v.change)), number(v.u, ".3g")) for v in comparison.values]
    return {"points": _without_marks(points), "lengths": _without_marks(lengths), "changes": values}


def _without_marks(rows: Rows) -> Rows:
    return rows if any(row[-1] for row in rows) else [row[:-1] for row in rows]


def _chance(probability: float | None, say: Say) -> str:
    return decimal(say.language, chance(probability))


def _held_out(record: CalibrationRecord, say: Say) -> Rows:
    poses = record.validation.get("held_out", {}).get("poses", ())
    return [(p["pose"], p["channel"], say.number(p["error_mm"], "+.4f"), say.number(p["u_mm"], ".4f")) for p in poses]


def _effects_shown(record: CalibrationRecord, say: Say) -> Rows:
    """Return how large physical effects must be to be named: kind, best and least channel, unit."""
    kinds: dict[tuple[str, str], list[float]] = {}
    for e in record.effects_shown:
        kinds.setdefault((e.effect, e.unit), []).append(e.size)
    return [
        (say.message(kind), say.number(min(own), ".2g"), say.number(max(own), ".2g"), say(f"unit_sign.{unit}"))
        for (kind, unit), own in kinds.items()
    ]


def _coarse(record: CalibrationRecord, say: Say) -> Rows:
    roots: dict[Any, str] = {True: say("calibration.chosen"), False: say("calibration.possible")}
    none = say("calibration.not_physical").replace(" ", "\u00a0")
    return [
        (c["point"], c["channel"], *(say.number(x, ".3f") for x in (*c["position_mm"], c["first_length_mm"])),
         say.number(settled(c["rms_mm"]), ".3g"), roots[bool(c["chosen"])] if c["chosen"] or c["physical"] else none)
        for c in record.coarse
    ]  # fmt: skip
