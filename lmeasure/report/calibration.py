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
        html.heading(say("The rig")),
        html.paragraph(say("Observation points with the cables at the first reference pose, and the reference poses. Drag to turn.")),
        html.figure(rig_figure(calibration, say), "rig", first=True, language=language),
        *_silence(record, say),
        *_residuals(calibration, say),
        *_predicted(calibration, say),
        *_validation(record, say),
        *_observability(record, say),
        html.heading(say("Values")),
        html.paragraph(say("u is the standard uncertainty; where it equals the prior's, the counts said nothing about that value.")),
        *_region(record, say),
        html.table(
            (say("value"), say("result"), "u", "U95", say("prior u")),
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
            html.heading(say("Inputs")),
            html.table((say("file"), "SHA-256"), ((i.file, i.sha256) for i in record.inputs), "text hashes"),
        ]
    html.write_page(path, say("Calibration of rig {rig}", rig=record.rig), body, language)


def verdict(record: CalibrationRecord, refused: str | None, say: Say = ENGLISH) -> list[str]:
    """Whether the rig may be used, how good it is, and what to know of it first."""
    if refused is not None:
        kind, told = "verdict bad", say("Not to be used: {why}.", why=say.told(refused))
    elif record.unobservable or any(w.code not in HARMLESS for w in record.warnings):
        kind, told = "verdict doubt", say("Calibrated, with reservations: read what is marked below.")
    else:
        kind, told = "verdict", say("Calibrated: nothing contradicts it.")
    rows = [
        (say("reference poses compared with the zero pose"), str(len({r.pose for r in record.residuals}))),
        (say("residuals"), say("{mm:.3g} mm rms", mm=settled(record.noise["residual_rms_mm"]))),
    ]
    if "position_rms_mm" in record.predicted:
        place = say("{mm:.3g} mm rms", mm=record.predicted["position_rms_mm"])
        if "position_worst_mm" in record.predicted:
            place += "; " + say("{mm:.3g} mm at worst", mm=record.predicted["position_worst_mm"])
        rows.append((say("the tool's place over the workspace, by the calibration alone, u"), place))
    if "against_nominal" in record.validation:
        against = record.validation["against_nominal"]
        told_of = say("{mm:.3g} mm rms; by the drawing {nominal:.3g} mm rms", mm=against["rms_mm"], nominal=against["nominal_mm"])
        rows.append((say("lengths at poses left out"), told_of))
    if "held_out" in record.validation:
        rows.append((say("lengths at poses held out"), say("{mm:.3g} mm rms", mm=record.validation["held_out"]["rms_mm"])))
    freedom = record.noise["degrees_of_freedom"]
    if not freedom:
        chi = say("none: no equation is left over")
    elif freedom == 1:
        chi = say("{chi:.4g} with 1 degree of freedom", chi=record.noise["chi_squared"])
    else:
        chi = say("{chi:.4g} with {freedom:.0f} degrees of freedom", chi=record.noise["chi_squared"], freedom=freedom)
    rows += [
        (say("equations, unknowns, directions that the counts determine"), f"{record.equations}, {record.unknowns}, {record.rank}"),
        (say("chi-squared"), chi),
    ]
    warnings = [html.warning(say.told(w.text), w.code) for w in record.warnings]
    return [html.paragraph(told, kind), *warnings, html.table((), rows, "text")]


HARMLESS = ("assumed_rotation", "assumed_position", "taken_as_exact")
"""Warnings that only say what was taken for what was not stated."""


def _residuals(calibration: Calibration, say: Say) -> list[str]:
    record = calibration.record
    parts = [html.heading(say("Residuals")), html.paragraph(say("Measured less modelled change of each cable since its zero pose."))]
    if not any(settled(r.mm) for r in record.residuals):
        # a drawing would show how the arithmetic was rounded
        told = say("All are zero: the counts tell as many directions as there are equations, and what fits them says nothing of errors.")
        return [*parts, html.paragraph(told)]
    figure = residuals_figure(record, calibration.campaign.rig, say)
    return [*parts, html.figure(figure, "residuals", first=False, language=say.language)]


def _region(record: CalibrationRecord, say: Say) -> list[str]:
    """What the joint region of the values is."""
    if not record.region:
        return []
    counts = say("whole counts, whose rounding is uniform") if record.region["whole_counts"] else say("counts with Gaussian noise")
    told = say(
        "U95 is the half width of each value's own interval of {percent:.0f} %; all values together lie within {factor:.3g} standard "
        "uncertainties of their joint covariance, from {counts}. The model's curvature adds {bend:.2g} standard uncertainties to the "
        "linear ones in the direction where it is largest; lengths and poses hardly feel it and inherit the linear covariance.",
        percent=100 * record.region["probability"],
        factor=record.region["factor"],
        counts=counts,
        bend=record.region["bend"],
    )
    return [html.paragraph(told)]


def _silence(record: CalibrationRecord, say: Say) -> list[str]:
    if not record.unobservable:
        return []
    told = say("Each is a motion by one prior standard uncertainty that changes no count. More and wider spread poses cure it.")
    return [
        html.heading(say("What the counts cannot tell")),
        html.paragraph(told),
        "<ul>" + "".join(f"<li>{html.kept(say.told(u.text))}</li>" for u in record.unobservable) + "</ul>",
    ]


def _observability(record: CalibrationRecord, say: Say) -> list[str]:
    """Directions by what the counts leave of the prior, and values by what they leave of their own."""
    if not record.spectrum:
        return []
    return [
        html.heading(say("What the counts see")),
        html.paragraph(
            say(
                "Every combination of values that the counts can tell apart, coloured by the point it is mostly made of. Below the line "
                "the counts know it better than the nominal rig; crosses are left to the prior. A value is a mixture of all of them, so "
                "that one weak direction spoils several values without spoiling a length."
            )
        ),
        html.figure(spectrum_figure(record, say), "spectrum", first=False, language=say.language),
        html.figure(narrowed_figure(record, say), "narrowed", first=False, language=say.language),
    ]


def _moved(comparison: Comparison | None, say: Say) -> list[str]:
    if comparison is None:
        return []
    number = say.number
    verdict = say("Something moved beyond the uncertainties.") if comparison.moved else say("Nothing moved beyond the uncertainties.")
    every = (*comparison.points, comparison.together)
    moved, by_chance = say("moved"), say("by chance")
    return [
        html.heading(say("Since the calibration {source}", source=comparison.source)),
        html.paragraph(verdict, "warning" if comparison.moved else ""),
        *(html.paragraph(say("Note: {note}", note=say.told(note))) for note in comparison.notes),
        html.paragraph(say("All values of a point jointly, in the directions of which both calibrations' counts tell something.")),
        _marked(
            (say("point"), say("shift, mm"), say("chi-squared"), say("directions"), by_chance, ""),
            [
                (
                    say("all") if p is comparison.together else p.point,
                    number(p.distance_mm, ".4f"),
                    number(p.chi_squared, ".4g"),
                    say("{n} of {of}", n=p.freedom, of=p.values),
                    _chance(p.probability, say),
                    moved if p.moved else "",
                )
                for p in every
            ],
        ),
        html.paragraph(say("What the two make of the same counts, over the workspace of the reference poses.")),
        _marked(
            (say("cable"), say("rms, mm"), say("worst, mm"), say("u there, mm"), by_chance, ""),
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
            (say("value"), say("before"), say("now"), say("change"), say("u of the change")),
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
        html.heading(say("Predicted standard uncertainty from this calibration")),
        html.paragraph(
            say(
                "Change of each cable since the zero pose, at {poses} poses in the box of the reference poses. This is what the instrument "
                "inherits; an observation point may be known ten times worse than the lengths it predicts.",
                poses=entry["poses"],
            )
        ),
        html.table((say("cable"), say("rms, mm"), say("worst, mm")), rows),
    ]
    if "position_rms_mm" in entry:
        parts.append(
            html.paragraph(
                say(
                    "Tool position {mm:.4f} mm rms, {worst:.4f} mm at worst; rotation {deg:.5f}° rms, {worst_deg:.5f}° at worst.",
                    mm=entry["position_rms_mm"],
                    worst=entry["position_worst_mm"],
                    deg=entry["rotation_rms_deg"],
                    worst_deg=entry["rotation_worst_deg"],
                )
            )
        )
    figure = html.figure(worst_figure(calibration, say), "predicted", first=False, language=say.language)
    return [*parts, html.paragraph(say("Worst cable at each pose:")), figure]


def _validation(record: CalibrationRecord, say: Say) -> list[str]:
    parts, number = [], say.number
    if "held_out" in record.validation:
        told = record.validation["held_out"]
        kept = [(p["pose"], p["channel"], number(p["error_mm"], "+.4f"), number(p["u_mm"], ".4f")) for p in told["poses"]]
        parts += [
            html.heading(say("Poses held out")),
            html.paragraph(
                say(
                    "They took no part in the fit. Their lengths were predicted to {mm:.4g} mm rms; {expected:.4g} mm were to be expected, "
                    "and {percent:.0f} % lie within their limits of 95 %.",
                    mm=told["rms_mm"],
                    expected=told["expected_mm"],
                    percent=100 * told["within_95"],
                )
            ),
            html.table((say("pose"), say("channel"), say("error, mm"), say("u, mm")), kept),
        ]
    if "against_nominal" in record.validation:
        told = record.validation["against_nominal"]
        parts += [
            html.heading(say("Against the drawing")),
            html.paragraph(
                say(
                    "Each of {poses} poses was predicted from all others: by this rig to {mm:.4g} mm rms, by the nominal one to "
                    "{nominal:.4g} mm. Errors as large as these, if this rig is no worse, have the probability {p:.2g}; below {least:g} it "
                    "is not delivered.",
                    poses=told["poses"],
                    mm=told["rms_mm"],
                    nominal=told["nominal_mm"],
                    p=told["p_worse"],
                    least=0.001,
                )
            ),
        ]
    if record.u_length_mm:
        rows = [(cable, number(u, ".4f")) for cable, u in record.u_length_mm.items()]
        parts += [
            html.heading(say("Lengths that err on their own")),
            html.paragraph(say("As the residuals show; in the uncertainties of everything measured with this rig.")),
            html.table((say("cable"), say("u, mm")), rows),
        ]
    if "poses" in record.validation:
        rows = [(p["pose"], number(p["rms_mm"], ".4f")) for p in record.validation["poses"]]
        left_out = record.validation["left_out_rms_mm"]
        parts += [
            html.heading(say("Each pose predicted by the others")),
            html.paragraph(
                say(
                    "A fit without a pose misses its lengths by {mm:.4g} mm rms, less what all poses tell of the zero pose's own error: "
                    "residuals hold it and may be larger.",
                    mm=left_out,
                )
            ),
            html.table((say("pose left out"), say("rms, mm")), rows),
        ]
    if record.correlations:
        parts += [
            html.heading(say("Values that cannot be told apart")),
            html.paragraph(say("Correlations beyond {limit:g}: quote such values together, or not at all.", limit=0.95)),
            html.table(
                (say("value"), say("with"), say("correlation")), ((c["a"], c["b"], number(c["value"], "+.4f")) for c in record.correlations)
            ),
        ]
    return parts


def _robust(record: CalibrationRecord, say: Say) -> list[str]:
    if not record.robust:
        return []
    rows = [(w["pose"], say.number(w["weight"], ".3f")) for w in sorted(record.robust["weights"], key=lambda w: float(w["weight"]))]
    told = say(
        "{loss} (constant {constant:g}) at {scale:.3g} times the stated noise: a pose that the others contradict counts less, one with "
        "weight 0 not at all.",
        loss=say.told(record.robust["loss"]),
        constant=record.robust["constant"],
        scale=record.robust["scale"],
    )
    return [html.heading(say("Robust loss")), html.paragraph(told), html.table((say("pose"), say("weight")), rows)]


def _ranges(record: CalibrationRecord, say: Say) -> list[str]:
    if not record.ranges:
        return []
    rows = (
        (
            r["point"],
            *(say("{low:.1f} to {high:.1f}", low=low, high=high) for low, high in zip(r["low_mm"], r["high_mm"], strict=True)),
            say("{n} of {of}", n=r["fitting"], of=r["tried"]),
        )
        for r in record.ranges
    )
    told = say("Each point was solved again with its assumed values held at sets drawn from their whole range: all these places fit.")
    return [
        html.heading(say("Result over the range of what nobody measured")),
        html.paragraph(told),
        html.table((say("point"), say("x, mm"), say("y, mm"), say("z, mm"), say("sets that fit")), rows),
    ]


def _coarse(record: CalibrationRecord, say: Say) -> list[str]:
    if not record.coarse:
        return []
    number = say.number
    roots = {True: say("chosen"), False: say("possible"), None: say("not physical").replace(" ", "\u00a0")}
    rows = (
        (c["point"], c["channel"], *(number(x, ".3f") for x in c["position_mm"]), number(c["first_length_mm"], ".3f"),
         number(settled(c["rms_mm"]), ".3g"), roots[bool(c["chosen"]) if c["chosen"] or c["physical"] else None])
        for c in record.coarse
    )  # fmt: skip
    columns = (say("point"), say("channel"), say("x, mm"), say("y, mm"), say("z, mm"), say("first length, mm"), say("rms, mm"), say("root"))
    return [html.heading(say("Coarse solutions: straight cables, both roots")), html.table(columns, rows)]
