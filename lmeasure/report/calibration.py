"""The page of a calibration: what must be known first, then the values, the residuals and the rig in 3-D."""

from collections import Counter
from pathlib import Path

import plotly.graph_objects as go

from lmeasure.calibration import Calibration
from lmeasure.calibration.compare import Comparison, chance
from lmeasure.calibration_record import CalibrationRecord
from lmeasure.kernels.cable import wrap_geometry
from lmeasure.report import html


def write_calibration_page(path: Path, calibration: Calibration, comparison: Comparison | None = None) -> None:
    """Write a self-contained HTML page of the calibration, and of what moved since an earlier one, whole or not at all."""
    record = calibration.record
    html.write_page(
        path,
        f"Calibration of rig {record.rig}",
        [
            *verdict(record, calibration.refused),
            *_moved(comparison),
            html.heading("The rig"),
            html.paragraph("Observation points with the cables at the first reference pose, and the reference poses. Drag to turn."),
            html.figure(_rig(calibration), "rig", first=True),
            *_silence(record),
            html.heading("Residuals"),
            html.paragraph("Measured less modelled change of each cable since its zero pose."),
            html.figure(residuals_figure(record), "residuals", first=False),
            *_predicted(calibration),
            *_validation(record),
            *_observability(record),
            html.heading("Values"),
            html.paragraph("u is the standard uncertainty; where it equals the prior's, the counts said nothing about that value."),
            *_region(record),
            html.table(
                ("value", "result", "u", "U95", "prior u"),
                ((p.name, f"{p.value:.4f}", f"{p.u:.3g}", f"{p.U95:.3g}", f"{p.prior_u:.3g}") for p in record.parameters),
            ),
            *_dimensions(record),
            *_ranges(record),
            *_robust(record),
            *_coarse(record),
            html.heading("Inputs"),
            html.table(("file", "SHA-256"), ((i.file, i.sha256) for i in record.inputs), "text"),
        ],
    )


def verdict(record: CalibrationRecord, refused: str | None) -> list[str]:
    """Whether the rig may be used, how good it is, and what to know of it first."""
    if refused is not None:
        kind, told = "verdict bad", f"Not to be used: {refused}."
    elif record.unobservable or any(w.code not in HARMLESS for w in record.warnings):
        kind, told = "verdict doubt", "Calibrated, with reservations: read what is marked below."
    else:
        kind, told = "verdict", "Calibrated: nothing contradicts it."
    rows = [("reference poses", str(len({r.pose for r in record.residuals}))), ("residuals", _mm(record.noise["residual_rms_mm"], "rms"))]
    if "position_rms_mm" in record.predicted:
        worst = _mm(record.predicted["position_worst_mm"], "at worst") if "position_worst_mm" in record.predicted else ""
        place = "; ".join(t for t in (_mm(record.predicted["position_rms_mm"], "rms"), worst) if t)
        rows.append(("the tool's place over the workspace, by the calibration alone, u", place))
    if "against_nominal" in record.validation:
        against = record.validation["against_nominal"]
        rows.append(("lengths at poses left out", f"{_mm(against['rms_mm'], 'rms')}; by the drawing {_mm(against['nominal_mm'], 'rms')}"))
    if "held_out" in record.validation:
        rows.append(("lengths at poses held out", _mm(record.validation["held_out"]["rms_mm"], "rms")))
    chi = f"{record.noise['chi_squared']:.4g} with {record.noise['degrees_of_freedom']:.0f} degrees of freedom"
    rows += [
        ("equations, unknowns, directions that the counts determine", f"{record.equations}, {record.unknowns}, {record.rank}"),
        ("chi-squared", chi),
    ]
    warnings = [html.paragraph(f"{w.code}: {w.text}", "warning") for w in record.warnings]
    return [html.paragraph(told, kind), *warnings, html.table((), rows, "text")]


def _mm(value: float, what: str) -> str:
    return f"{value:.3g} mm {what}"


HARMLESS = ("assumed_rotation", "assumed_position", "taken_as_exact")
"""Warnings that only say what was taken for what was not stated."""


def _region(record: CalibrationRecord) -> list[str]:
    """What the joint region of the values is."""
    if not record.region:
        return []
    counts = "whole counts, whose rounding is uniform" if record.region["whole_counts"] else "counts with Gaussian noise"
    return [
        html.paragraph(
            f"U95 is the half width of each value's own interval of {100 * record.region['probability']:.0f} %; all values together "
            f"lie within {record.region['factor']:.3g} standard uncertainties of their joint covariance, from {counts}. The model's "
            f"curvature adds {record.region['bend']:.2g} standard uncertainties to the linear ones in the direction where it is largest; "
            "lengths and poses hardly feel it and inherit the linear covariance."
        )
    ]


def _dimensions(record: CalibrationRecord) -> list[str]:
    """What was not solved: stated to be uncertain, or taken as exact."""
    parts = []
    if record.dimensions:
        rows = ((d.name, f"{d.value:.7g}", f"{d.u:.3g}", f"{d.prior_u:.3g}") for d in record.dimensions)
        parts += [
            html.heading("Dimensions stated to be uncertain"),
            html.paragraph("They were not solved. The residuals correct them as far as they tell, and the rig has the corrected values."),
            html.table(("value", "corrected", "u", "stated u"), rows),
        ]
    if record.taken_as_exact:
        of_place = "position_rms_mm" in record.predicted
        usual = ((str(t["text"]), str(t["usual"]), f"{t['mm']:.3g}") for t in record.taken_as_exact)
        parts += [
            html.heading("Taken as exact, not stated"),
            html.paragraph(
                "What the rig does not state and nothing has solved is in no uncertainty here. What a usual size of it would add to "
                + ("the tool's place in a run, " if of_place else "the lengths together in a run, ")
                + "at worst over the workspace, by itself; the keys that state it are in docs/budget.md."
            ),
            html.table(("what", "usual size", "mm"), usual),
        ]
    return parts


def _silence(record: CalibrationRecord) -> list[str]:
    if not record.unobservable:
        return []
    return [
        html.heading("What the counts cannot tell"),
        html.paragraph("Each line moves by one prior standard uncertainty without changing a count. More and wider spread poses cure it."),
        "<ul>" + "".join(f"<li>{html.text(u.text)}</li>" for u in record.unobservable) + "</ul>",
    ]


def _observability(record: CalibrationRecord) -> list[str]:
    """Directions by what the counts leave of the prior, and values by what they leave of their own."""
    if not record.spectrum:
        return []
    figure = go.Figure()
    for point in sorted({str(d["point"]) for d in record.spectrum}):
        own = [(i, d) for i, d in enumerate(record.spectrum, 1) if d["point"] == point]
        symbols = ["circle" if d["known"] else "x" for _, d in own]
        figure.add_scatter(
            x=[i for i, _ in own],
            y=[d["left"] for _, d in own],
            mode="markers",
            name=html.label(point),
            marker={"symbol": symbols, "size": 8},
        )
    figure.add_hline(y=1.0, line={"dash": "dash"})
    # on a logarithmic axis an annotation lies at the logarithm
    at = {"x": 0.0, "xref": "paper", "xanchor": "left", "y": 0.0, "yanchor": "bottom", "showarrow": False}
    figure.add_annotation(text="the prior knows it as well", **at)
    figure.update_layout(height=380, margin={"t": 20}, xaxis={"title": "direction, best seen first"})
    figure.update_yaxes(title="standard uncertainty left, in prior ones", type="log")
    values = go.Figure()
    names = [html.label(p.name) for p in record.parameters]
    priors = [p.prior_u for p in record.parameters]
    values.add_scatter(y=names, x=priors, mode="markers", name="prior", marker={"symbol": "line-ns-open", "size": 9})
    values.add_scatter(y=names, x=[p.u for p in record.parameters], mode="markers", name="calibrated")
    # a row for each name: they never stand in each other's way
    values.update_layout(height=110 + 18 * len(names), margin={"t": 20, "r": 10}, legend={"orientation": "h", "y": 1, "yanchor": "bottom"})
    values.update_xaxes(title="standard uncertainty, mm or deg", type="log")
    values.update_yaxes(autorange="reversed", dtick=1, automargin=True)
    return [
        html.heading("What the counts see"),
        html.paragraph(
            "Every combination of values that the counts can tell apart, coloured by the point it is mostly made of. Below the line "
            "the counts know it better than the nominal rig; crosses are left to the prior. A value is a mixture of all of them, so that "
            "one weak direction spoils several values without spoiling a length."
        ),
        html.figure(figure, first=False),
        html.figure(values, first=False),
    ]


def _moved(comparison: Comparison | None) -> list[str]:
    if comparison is None:
        return []
    verdict = "Something moved beyond the uncertainties." if comparison.moved else "Nothing moved beyond the uncertainties."
    every = (*comparison.points, comparison.together)
    return [
        html.heading(f"Since the calibration {comparison.source}"),
        html.paragraph(verdict, "warning" if comparison.moved else ""),
        *(html.paragraph(f"note: {note}") for note in comparison.notes),
        html.paragraph("All values of a point jointly, in the directions of which both calibrations' counts tell something."),
        html.table(
            ("point", "shift, mm", "chi-squared", "directions", "by chance", ""),
            (
                (p.point, f"{p.distance_mm:.4f}", f"{p.chi_squared:.4g}", f"{p.freedom} of {p.values}", chance(p.probability),
                 "moved" if p.moved else "")
                for p in every
            ),
        ),
        html.paragraph("What the two make of the same counts, over the workspace of the reference poses."),
        html.table(
            ("cable", "rms, mm", "worst, mm", "u there, mm", "by chance", ""),
            (
                (c.cable, f"{c.rms_mm:.4f}", f"{c.worst_mm:.4f}", f"{c.u_mm:.4f}", chance(c.probability), "moved" if c.moved else "")
                for c in comparison.lengths
            ),
        ),
        html.table(
            ("value", "before", "now", "change", "u of the change"),
            ((v.name, f"{v.old:.4f}", f"{v.new:.4f}", f"{v.change:.4f}", f"{v.u:.3g}") for v in comparison.values),
        ),
    ]  # fmt: skip


def _predicted(calibration: Calibration) -> list[str]:
    """What the calibration's own uncertainty does to lengths and poses over the workspace of the reference poses."""
    entry, predicted = calibration.record.predicted, calibration.predicted
    rows = [(e["cable"], f"{e['rms_mm']:.4f}", f"{e['worst_mm']:.4f}") for e in entry["lengths"]]
    parts = [
        html.heading("Predicted standard uncertainty from this calibration"),
        html.paragraph(
            f"Change of each cable since the zero pose, at {entry['poses']} poses in the box of the reference poses. This is what the "
            "instrument inherits; an observation point may be known ten times worse than the lengths it predicts."
        ),
        html.table(("cable", "rms, mm", "worst, mm"), rows),
    ]
    if "position_rms_mm" in entry:
        parts.append(
            html.paragraph(
                f"Tool position {entry['position_rms_mm']:.4f} mm rms, {entry['position_worst_mm']:.4f} mm at worst; "
                f"rotation {entry['rotation_rms_deg']:.5f} deg rms, {entry['rotation_worst_deg']:.5f} deg at worst."
            )
        )
    worst = predicted.length_mm.max(axis=1)
    x, y, z = predicted.rows[:, :3].T
    marker = {"size": 4, "color": worst, "colorscale": "Viridis", "colorbar": {"title": "mm"}}
    figure = go.Figure(
        go.Scatter3d(
            x=x,
            y=y,
            z=z,
            mode="markers",
            marker=marker,
            hovertemplate="%{marker.color:.4f} mm<br>%{x:.0f}, %{y:.0f}, %{z:.0f}<extra></extra>",
        )
    )
    axes = {"xaxis_title": "X, mm", "yaxis_title": "Y, mm", "zaxis_title": "Z, mm", "aspectmode": "data"}
    figure.update_layout(height=520, margin={"t": 10}, scene=axes)
    return [*parts, html.paragraph("Worst cable at each pose:"), html.figure(figure, first=False)]


def _validation(record: CalibrationRecord) -> list[str]:
    parts = []
    if "held_out" in record.validation:
        told = record.validation["held_out"]
        kept = [(p["pose"], p["channel"], f"{p['error_mm']:+.4f}", f"{p['u_mm']:.4f}") for p in told["poses"]]
        parts += [
            html.heading("Poses held out"),
            html.paragraph(
                f"They took no part in the fit. Their lengths were predicted to {told['rms_mm']:.4g} mm rms; {told['expected_mm']:.4g} mm "
                f"were to be expected, and {100 * told['within_95']:.0f} % lie within their 95 %."
            ),
            html.table(("pose", "channel", "error, mm", "u, mm"), kept),
        ]
    if "against_nominal" in record.validation:
        told = record.validation["against_nominal"]
        parts += [
            html.heading("Against the drawing"),
            html.paragraph(
                f"Each of {told['poses']} poses was predicted from all others: by this rig to {told['rms_mm']:.4g} mm rms, by the nominal "
                f"one to {told['nominal_mm']:.4g} mm. Errors as large as these, if this rig is no worse, have the probability "
                f"{told['p_worse']:.2g}; below 0.001 it is not delivered."
            ),
        ]
    if record.u_length_mm:
        rows = [(cable, f"{u:.4f}") for cable, u in record.u_length_mm.items()]
        parts += [
            html.heading("Lengths that err on their own"),
            html.paragraph("As the residuals show; in the uncertainties of everything measured with this rig."),
            html.table(("cable", "u, mm"), rows),
        ]
    if "poses" in record.validation:
        rows = [(p["pose"], f"{p['rms_mm']:.4f}") for p in record.validation["poses"]]
        parts += [
            html.heading("Each pose predicted by the others"),
            html.paragraph(f"A fit without a pose misses its lengths by {record.validation['left_out_rms_mm']:.4g} mm rms."),
            html.table(("pose left out", "rms, mm"), rows),
        ]
    if record.correlations:
        parts += [
            html.heading("Values that cannot be told apart"),
            html.paragraph("Correlations beyond 0.95: quote such values together, or not at all."),
            html.table(("value", "with", "correlation"), ((c["a"], c["b"], f"{c['value']:+.4f}") for c in record.correlations)),
        ]
    return parts


def _robust(record: CalibrationRecord) -> list[str]:
    if not record.robust:
        return []
    rows = [(w["pose"], f"{w['weight']:.3f}") for w in sorted(record.robust["weights"], key=lambda w: float(w["weight"]))]
    told = f"{record.robust['loss']} (constant {record.robust['constant']:g}) at {record.robust['scale']:.3g} times the stated noise"
    return [
        html.heading("Robust loss"),
        html.paragraph(f"{told}: a pose that the others contradict counts less, one with weight 0 not at all."),
        html.table(("pose", "weight"), rows),
    ]


def _ranges(record: CalibrationRecord) -> list[str]:
    if not record.ranges:
        return []
    rows = (
        (
            r["point"],
            *(f"{low:.1f} to {high:.1f}" for low, high in zip(r["low_mm"], r["high_mm"], strict=True)),
            f"{r['fitting']} of {r['tried']}",
        )
        for r in record.ranges
    )
    return [
        html.heading("Result over the range of what nobody measured"),
        html.paragraph(
            "Each point was solved again with its assumed values held at sets drawn from their whole range: all these places fit."
        ),
        html.table(("point", "x, mm", "y, mm", "z, mm", "sets that fit"), rows),
    ]


def _coarse(record: CalibrationRecord) -> list[str]:
    if not record.coarse:
        return []
    rows = (
        (c["point"], c["channel"], *(f"{x:.3f}" for x in c["position_mm"]), f"{c['first_length_mm']:.3f}", f"{c['rms_mm']:.3g}",
         "chosen" if c["chosen"] else "possible" if c["physical"] else "not physical")
        for c in record.coarse
    )  # fmt: skip
    header = ("point", "channel", "x, mm", "y, mm", "z, mm", "first length, mm", "rms, mm", "root")
    return [html.heading("Coarse solutions: straight cables, both roots"), html.table(header, rows)]


def residuals_figure(record: CalibrationRecord) -> go.Figure:
    """Residual of each channel at each reference pose."""
    figure = go.Figure()
    for channel in Counter(r.channel for r in record.residuals):
        own = [r for r in record.residuals if r.channel == channel]
        figure.add_scatter(x=[r.pose for r in own], y=[r.mm for r in own], mode="markers", name=html.label(channel))
    figure.update_layout(
        height=420,
        margin={"t": 20},
        xaxis={"title": "reference pose", "type": "category"},
        yaxis={"title": "residual, mm; of angles, mrad"},
    )
    return figure


def _rig(calibration: Calibration) -> go.Figure:
    """Observation points, reference poses, and the cables at the first pose with their tangent points."""
    campaign, rig = calibration.campaign, calibration.rig
    rows = rig.cable_rows(campaign.drums)
    _, tangent, attachment, _ = wrap_geometry(rows, campaign.poses.rows[:1])
    figure = go.Figure()
    for j, c in enumerate(campaign.drums):
        line = [rows[j, :3], tangent[0, j], attachment[0, j]]
        figure.add_scatter3d(
            x=[p[0] for p in line], y=[p[1] for p in line], z=[p[2] for p in line], mode="lines", line={"width": 4}, name=html.label(c.name)
        )
    points = [p for p in rig.observation_point if any(c.from_point == p.name for c in campaign.drums)]
    x, y, z = zip(*(p.position_mm for p in points), strict=True)
    names = [f"\u00a0\u00a0{html.label(p.name)}" for p in points]
    figure.add_scatter3d(
        x=x, y=y, z=z, mode="markers+text", text=names, textposition="middle right", marker={"size": 4, "color": "black"},
        name="observation points",
    )  # fmt: skip
    x, y, z = campaign.poses.rows[:, :3].T
    names = [html.label(n) for n in campaign.poses.names]
    figure.add_scatter3d(x=x, y=y, z=z, mode="markers", text=names, marker={"size": 3, "color": "gray"}, name="reference poses")
    axes = {"xaxis_title": "X, mm", "yaxis_title": "Y, mm", "zaxis_title": "Z, mm", "aspectmode": "data"}
    figure.update_layout(height=640, margin={"t": 10}, scene=axes)
    return figure
