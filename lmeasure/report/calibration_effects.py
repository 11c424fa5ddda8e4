"""What the page of a calibration says of physical effects and of dimensions that were not solved."""

from lmeasure.report import html
from lmeasure.rig import CalibrationRecord
from lmeasure.text import Say


def effects(record: CalibrationRecord, say: Say) -> list[str]:
    """What the counts say of the physical effects that were solved for."""
    if not record.effects:
        return []
    number = say.number
    rows = (
        (e.owner, e.effect, number(e.value, ".4g"), number(e.u, ".2g"), e.unit, number(e.probability, ".2g"), number(e.bits, ".1f"))
        + (say("calibration.found") if e.found else say("page.not_told") if e.bits < 1.0 else say("calibration.not_found"),)
        for e in record.effects
    )
    return [
        html.heading(say("calibration.physical_effects")),
        html.paragraph(say("calibration.how_much_each_differs")),
        html.table(
            (
                say("calibration.point"),
                say("calibration.effect"),
                say("calibration.size"),
                "u",
                say("page.unit"),
                "p",
                say("calibration.bits"),
                "",
            ),
            rows,
        ),
    ]


def effects_shown(record: CalibrationRecord, say: Say) -> list[str]:
    """How large physical effects must be to be named."""
    kinds: dict[tuple[str, str], list[float]] = {}
    for e in record.effects_shown:
        kinds.setdefault((e.effect, e.unit), []).append(e.size)
    if not kinds:
        return []
    number = say.number
    rows = (
        (say.message(kind), number(min(own), ".2g"), number(max(own), ".2g"), say(f"unit_sign.{unit}"))
        for (kind, unit), own in kinds.items()
    )
    return [
        html.heading(say("calibration.physical_effects_residuals_would")),
        html.paragraph(say("calibration.how_large_each_must")),
        html.table((say("calibration.effect"), say("calibration.best"), say("calibration.least"), say("page.unit")), rows),
    ]


def dimensions(record: CalibrationRecord, say: Say) -> list[str]:
    """What was not solved: stated to be uncertain, or taken as exact."""
    parts, number = [], say.number
    if record.dimensions:
        rows = ((d.name, number(d.value, ".7g"), number(d.u, ".3g"), number(d.prior_u, ".3g")) for d in record.dimensions)
        parts += [
            html.heading(say("calibration.dimensions_stated_uncertain")),
            html.paragraph(say("calibration.they_were_not_solved")),
            html.table((say("page.value"), say("calibration.corrected"), "u", say("calibration.stated_u")), rows),
        ]
    if record.taken_as_exact:
        of_place = "position_rms_mm" in record.predicted
        whose = say("calibration.tools_place_run") if of_place else say("calibration.lengths_together_run")
        usual = ((say.message(t["text"]), say.message(t["usual"]), number(t["mm"], ".3g")) for t in record.taken_as_exact)
        parts += [
            html.heading(say("calibration.taken_exact_not_stated")),
            html.paragraph(say("calibration.rig_does_not_state", whose=whose)),
            html.table((say("calibration.what"), say("calibration.usual_size"), say("page.mm")), usual),
        ]
    return parts
