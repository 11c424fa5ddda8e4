"""The page of a calibration: what must be known first, then the values, the residuals and the rig in 3-D."""

from pathlib import Path

from lmeasure.calibration import Calibration, Comparison, chance
from lmeasure.report import html
from lmeasure.report.calibration_effects import dimensions, effects, effects_shown
from lmeasure.report.calibration_figures import narrowed_figure, residuals_figure, rig_figure, spectrum_figure, worst_figure
from lmeasure.rig import CalibrationRecord
from lmeasure.text import ENGLISH, Say, decimal, settled


def write_calibration_page(path: Path, calibration: Calibration, comparison: Comparison | None = None, language: str = "en") -> None:
    """Write a self-contained HTML page of the calibration, and of what moved since an earlier one, whole or not at all."""
    record, say = calibration.record, Say(language)
    number = say.number
    body = [
        *verdict(record, calibration.refused, say),
        *_moved(comparison, say),
        html.heading(say("page.rig")),
        html.paragraph(say("calibration.observation_points_cables_first")),
        html.figure(rig_figure(calibration, say), "rig", first=True, language=language),
        *_silence(record, say),
        *_residuals(calibration, say),
        *_predicted(calibration, say),
        *_validation(record, say),
        *_observability(record, say),
        html.heading(say("page.values")),
        html.paragraph(say("calibration.u_standard_uncertainty_where")),
        *_region(record, say),
        html.table(
            (say("page.value"), say("page.result"), "u", "U95", say("calibration.prior_u")),
            (
                (
                    p.name,
                    number(p.value, ".4f"),
                    number(p.u, ".3g"),
                    "" if p.U95 is None else number(p.U95, ".3g"),
                    number(p.prior_u, ".3g"),
                )
                for p in record.parameters
            ),
        ),
        *effects(record, say),
        *effects_shown(record, say),
        *dimensions(record, say),
        *_ranges(record, say),
        *_robust(record, say),
        *_coarse(record, say),
    ]
    if record.inputs:
        body += [
            html.heading(say("page.inputs")),
            html.table((say("page.file"), "SHA-256"), ((i.file, i.sha256) for i in record.inputs), "text hashes"),
        ]
    html.write_page(path, say("calibration.calibration_rig", rig=record.rig), body, language)


def verdict(record: CalibrationRecord, refused: str | None, say: Say = ENGLISH) -> list[str]:
    """Whether the rig may be used, how good it is, and what to know of it first."""
    if refused is not None:
        kind, reported = "verdict bad", say("calibration.not_used", why=say.message(refused))
    elif record.unobservable or any(w.code not in HARMLESS for w in record.warnings):
        kind, reported = "verdict doubt", say("calibration.calibrated_reservations_read_marked")
    else:
        kind, reported = "verdict", say("calibration.calibrated_nothing_contradicts")
    rows = [
        (say("calibration.reference_poses_compared_zero"), str(len({r.pose for r in record.residuals}))),
        (say("calibration.residuals_2"), say("calibration.mm_rms", mm=settled(record.noise["residual_rms_mm"]))),
    ]
    if "position_rms_mm" in record.predicted:
        place = say("calibration.mm_rms", mm=record.predicted["position_rms_mm"])
        if "position_worst_mm" in record.predicted:
            place += "; " + say("calibration.mm_worst", mm=record.predicted["position_worst_mm"])
        rows.append((say("calibration.tools_place_over_workspace"), place))
    if "against_nominal" in record.validation:
        against = record.validation["against_nominal"]
        told_of = say("calibration.mm_rms_drawing_mm", mm=against["rms_mm"], nominal=against["nominal_mm"])
        rows.append((say("calibration.lengths_poses_left_out"), told_of))
    if "held_out" in record.validation:
        rows.append((say("calibration.lengths_poses_held_out"), say("calibration.mm_rms", mm=record.validation["held_out"]["rms_mm"])))
    freedom = record.noise["degrees_of_freedom"]
    if not freedom:
        chi = say("calibration.none_no_equation_left")
    elif freedom == 1:
        chi = say("calibration.1_degree_freedom", chi=record.noise["chi_squared"])
    else:
        chi = say("calibration.degrees_freedom", chi=record.noise["chi_squared"], freedom=freedom)
    rows += [
        (say("calibration.equations_unknowns_directions_counts"), f"{record.equations}, {record.unknowns}, {record.rank}"),
        (say("calibration.chi_squared"), chi),
    ]
    warnings = [html.warning(say.message(w.text), w.code) for w in record.warnings]
    return [html.paragraph(reported, kind), *warnings, html.table((), rows, "text")]


HARMLESS = ("assumed_rotation", "assumed_position", "taken_as_exact")
"""Warnings that only say what was taken for what was not stated."""


def _residuals(calibration: Calibration, say: Say) -> list[str]:
    record = calibration.record
    parts = [html.heading(say("calibration.residuals")), html.paragraph(say("calibration.measured_less_modelled_change"))]
    if not any(settled(r.mm) for r in record.residuals):
        # a drawing would show how the arithmetic was rounded
        reported = say("calibration.all_zero_counts_tell")
        return [*parts, html.paragraph(reported)]
    figure = residuals_figure(record, calibration.campaign.rig, say)
    return [*parts, html.figure(figure, "residuals", first=False, language=say.language)]


def _region(record: CalibrationRecord, say: Say) -> list[str]:
    """What the joint region of the values is."""
    if not record.region:
        return []
    counts = say("calibration.whole_counts_whose_rounding") if record.region["whole_counts"] else say("calibration.counts_gaussian_noise")
    reported = say(
        "calibration.u95_half_width_each",
        percent=100 * record.region["probability"],
        factor=record.region["factor"],
        counts=counts,
        bend=record.region["bend"],
    )
    return [html.paragraph(reported)]


def _silence(record: CalibrationRecord, say: Say) -> list[str]:
    if not record.unobservable:
        return []
    reported = say("calibration.each_motion_one_prior")
    return [
        html.heading(say("calibration.counts_cannot_tell")),
        html.paragraph(reported),
        "<ul>" + "".join(f"<li>{html.kept(say.message(u.text))}</li>" for u in record.unobservable) + "</ul>",
    ]


def _observability(record: CalibrationRecord, say: Say) -> list[str]:
    """Directions by what the counts leave of the prior, and values by what they leave of their own."""
    if not record.spectrum:
        return []
    return [
        html.heading(say("calibration.counts_see")),
        html.paragraph(say("calibration.every_combination_values_counts")),
        html.figure(spectrum_figure(record, say), "spectrum", first=False, language=say.language),
        html.figure(narrowed_figure(record, say), "narrowed", first=False, language=say.language),
    ]


def _moved(comparison: Comparison | None, say: Say) -> list[str]:
    if comparison is None:
        return []
    number = say.number
    verdict = (
        say("calibration.something_moved_beyond_uncertainties")
        if comparison.moved
        else say("calibration.nothing_moved_beyond_uncertainties")
    )
    every = (*comparison.points, comparison.together)
    moved, by_chance = say("page.moved"), say("page.chance")
    return [
        html.heading(say("calibration.since_calibration", source=comparison.source)),
        html.paragraph(verdict, "warning" if comparison.moved else ""),
        *(html.paragraph(say("calibration.note", note=say.message(note))) for note in comparison.notes),
        html.paragraph(say("calibration.all_values_point_jointly")),
        _marked(
            (
                say("calibration.point"),
                say("calibration.shift_mm"),
                say("calibration.chi_squared"),
                say("calibration.directions"),
                by_chance,
                "",
            ),
            [
                (
                    say("calibration.all") if p is comparison.together else p.point,
                    number(p.distance_mm, ".4f"),
                    number(p.chi_squared, ".4g"),
                    say("page.of", n=p.freedom, of=p.values),
                    _chance(p.probability, say),
                    moved if p.moved else "",
                )
                for p in every
            ],
        ),
        html.paragraph(say("calibration.two_make_same_counts")),
        _marked(
            (say("page.cable"), say("calibration.rms_mm"), say("calibration.worst_mm"), say("calibration.u_there_mm"), by_chance, ""),
            [
                (
                    c.cable,
                    number(c.rms_mm, ".4f"),
                    number(c.worst_mm, ".4f"),
                    number(c.u_mm, ".4f"),
                    _chance(c.probability, say),
                    moved if c.moved else "",
                )
                for c in comparison.lengths
            ],
        ),
        html.table(
            (say("page.value"), say("page.before"), say("calibration.now"), say("calibration.change"), say("calibration.u_change")),
            ((v.name, *(number(x, ".4f") for x in (v.old, v.new, v.change)), number(v.u, ".3g")) for v in comparison.values),
        ),
    ]


def _marked(header: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A table whose last column marks some rows; without it where none is marked."""
    kept = None if any(row[-1] for row in rows) else -1
    return html.table(header[:kept], (row[:kept] for row in rows))


def _chance(probability: float | None, say: Say) -> str:
    return decimal(say.language, chance(probability))


def _predicted(calibration: Calibration, say: Say) -> list[str]:
    """What the calibration's own uncertainty does to lengths and poses over the workspace of the reference poses."""
    entry = calibration.record.predicted
    rows = [(e["cable"], say.number(e["rms_mm"], ".4f"), say.number(e["worst_mm"], ".4f")) for e in entry["lengths"]]
    parts = [
        html.heading(say("calibration.predicted_standard_uncertainty_from")),
        html.paragraph(say("calibration.change_each_cable_since", poses=entry["poses"])),
        html.table((say("page.cable"), say("calibration.rms_mm"), say("calibration.worst_mm")), rows),
    ]
    if "position_rms_mm" in entry:
        parts.append(
            html.paragraph(
                say(
                    "calibration.tool_position_mm_rms",
                    mm=entry["position_rms_mm"],
                    worst=entry["position_worst_mm"],
                    deg=entry["rotation_rms_deg"],
                    worst_deg=entry["rotation_worst_deg"],
                )
            )
        )
    figure = html.figure(worst_figure(calibration, say), "predicted", first=False, language=say.language)
    return [*parts, html.paragraph(say("calibration.worst_cable_each_pose")), figure]


def _validation(record: CalibrationRecord, say: Say) -> list[str]:
    parts, number = [], say.number
    if "held_out" in record.validation:
        reported = record.validation["held_out"]
        kept = [(p["pose"], p["channel"], number(p["error_mm"], "+.4f"), number(p["u_mm"], ".4f")) for p in reported["poses"]]
        parts += [
            html.heading(say("calibration.poses_held_out")),
            html.paragraph(
                say(
                    "calibration.they_took_no_part",
                    mm=reported["rms_mm"],
                    expected=reported["expected_mm"],
                    percent=100 * reported["within_95"],
                )
            ),
            html.table((say("page.pose"), say("page.channel"), say("page.error_mm"), say("calibration.u_mm")), kept),
        ]
    if "against_nominal" in record.validation:
        reported = record.validation["against_nominal"]
        parts += [
            html.heading(say("calibration.against_drawing")),
            html.paragraph(
                say(
                    "calibration.each_poses_was_predicted",
                    poses=reported["poses"],
                    mm=reported["rms_mm"],
                    nominal=reported["nominal_mm"],
                    p=reported["p_worse"],
                    least=0.001,
                )
            ),
        ]
    if record.u_length_mm:
        rows = [(cable, number(u, ".4f")) for cable, u in record.u_length_mm.items()]
        parts += [
            html.heading(say("calibration.lengths_err_their_own")),
            html.paragraph(say("calibration.residuals_show_uncertainties_everything")),
            html.table((say("page.cable"), say("calibration.u_mm")), rows),
        ]
    if "poses" in record.validation:
        rows = [(p["pose"], number(p["rms_mm"], ".4f")) for p in record.validation["poses"]]
        left_out = record.validation["left_out_rms_mm"]
        parts += [
            html.heading(say("calibration.each_pose_predicted_others")),
            html.paragraph(say("calibration.fit_without_pose_misses", mm=left_out)),
            html.table((say("calibration.pose_left_out"), say("calibration.rms_mm")), rows),
        ]
    if record.correlations:
        parts += [
            html.heading(say("calibration.values_cannot_told_apart")),
            html.paragraph(say("calibration.correlations_beyond_quote_such", limit=0.95)),
            html.table(
                (say("page.value"), say("calibration.with"), say("calibration.correlation")),
                ((c["a"], c["b"], number(c["value"], "+.4f")) for c in record.correlations),
            ),
        ]
    return parts


def _robust(record: CalibrationRecord, say: Say) -> list[str]:
    if not record.robust:
        return []
    rows = [(w["pose"], say.number(w["weight"], ".3f")) for w in sorted(record.robust["weights"], key=lambda w: float(w["weight"]))]
    reported = say(
        "calibration.constant_times_stated_noise",
        loss=say.message(record.robust["loss"]),
        constant=record.robust["constant"],
        scale=record.robust["scale"],
    )
    return [
        html.heading(say("calibration.robust_loss")),
        html.paragraph(reported),
        html.table((say("page.pose"), say("page.weight")), rows),
    ]


def _ranges(record: CalibrationRecord, say: Say) -> list[str]:
    if not record.ranges:
        return []
    rows = (
        (
            r["point"],
            *(say("calibration.to", low=low, high=high) for low, high in zip(r["low_mm"], r["high_mm"], strict=True)),
            say("page.of", n=r["fitting"], of=r["tried"]),
        )
        for r in record.ranges
    )
    reported = say("calibration.each_point_was_solved")
    return [
        html.heading(say("calibration.result_over_range_nobody")),
        html.paragraph(reported),
        html.table((say("calibration.point"), say("page.x_mm"), say("page.y_mm"), say("page.z_mm"), say("calibration.sets_fit")), rows),
    ]


def _coarse(record: CalibrationRecord, say: Say) -> list[str]:
    if not record.coarse:
        return []
    number = say.number
    roots = {
        True: say("calibration.chosen"),
        False: say("calibration.possible"),
        None: say("calibration.not_physical").replace(" ", "\u00a0"),
    }
    rows = (
        (c["point"], c["channel"], *(number(x, ".3f") for x in c["position_mm"]), number(c["first_length_mm"], ".3f"),
         number(settled(c["rms_mm"]), ".3g"), roots[bool(c["chosen"]) if c["chosen"] or c["physical"] else None])
        for c in record.coarse
    )  # fmt: skip
    columns = (
        say("calibration.point"),
        say("page.channel"),
        say("page.x_mm"),
        say("page.y_mm"),
        say("page.z_mm"),
        say("calibration.first_length_mm"),
        say("calibration.rms_mm"),
        say("calibration.root"),
    )
    return [html.heading(say("calibration.coarse_solutions_straight_cables")), html.table(columns, rows)]
