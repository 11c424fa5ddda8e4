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
        + (say("found") if e.found else say("not told") if e.bits < 1.0 else say("not found"),)
        for e in record.effects
    )
    return [
        html.heading(say("Physical effects")),
        html.paragraph(
            say(
                "By how much each differs from what the rig stated, how likely chance is to look like it, and what the counts told of it: "
                "under one bit its law is that of something else that was solved."
            )
        ),
        html.table((say("point"), say("effect"), say("size"), "u", say("unit"), "p", say("bits"), ""), rows),
    ]


def effects_shown(record: CalibrationRecord, say: Say) -> list[str]:
    """How large physical effects must be to be named."""
    kinds: dict[tuple[str, str], list[float]] = {}
    for e in record.effects_shown:
        kinds.setdefault((e.effect, e.unit), []).append(e.size)
    if not kinds:
        return []
    number = say.number
    rows = ((say.told(kind), number(min(own), ".2g"), number(max(own), ".2g"), say.told(unit)) for (kind, unit), own in kinds.items())
    return [
        html.heading(say("Physical effects that the residuals would show")),
        html.paragraph(
            say(
                "How large each must be to be named in the warnings with a probability of 80 %, of the channel that shows it best and of "
                "the one that shows it least. What is far larger than such things are is not told by these poses."
            )
        ),
        html.table((say("effect"), say("best"), say("least"), say("unit")), rows),
    ]


def dimensions(record: CalibrationRecord, say: Say) -> list[str]:
    """What was not solved: stated to be uncertain, or taken as exact."""
    parts, number = [], say.number
    if record.dimensions:
        rows = ((d.name, number(d.value, ".7g"), number(d.u, ".3g"), number(d.prior_u, ".3g")) for d in record.dimensions)
        parts += [
            html.heading(say("Dimensions stated to be uncertain")),
            html.paragraph(
                say("They were not solved. The residuals correct them as far as they tell, and the rig has the corrected values.")
            ),
            html.table((say("value"), say("corrected"), "u", say("stated u")), rows),
        ]
    if record.taken_as_exact:
        of_place = "position_rms_mm" in record.predicted
        whose = say("the tool's place in a run") if of_place else say("the lengths together in a run")
        usual = ((say.told(str(t["text"])), say.told(str(t["usual"])), number(t["mm"], ".3g")) for t in record.taken_as_exact)
        parts += [
            html.heading(say("Taken as exact, not stated")),
            html.paragraph(
                say(
                    "What the rig does not state and nothing has solved is in no uncertainty here. What a usual size of it would add to "
                    "{whose}, at worst over the workspace, by itself; the keys that state it are in docs/budget.md.",
                    whose=whose,
                )
            ),
            html.table((say("what"), say("usual size"), say("mm")), usual),
        ]
    return parts
