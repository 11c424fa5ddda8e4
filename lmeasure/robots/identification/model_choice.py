"""What is worth freeing, decided by the measurements: families of parameters are freed one after the other while a test asks for it."""

from collections.abc import Sequence
from dataclasses import replace

from lmeasure.robots.identification.hold_out import worth_freeing
from lmeasure.robots.identification.identify import Identified, Settings, identify
from lmeasure.robots.identification.measurements import Measurements
from lmeasure.robots.identification.notes import Noted, noted
from lmeasure.robots.identification.unknowns import R

FALSE_ALARM = 1e-3
"""Probability with which a family that the robot has nothing of is freed."""
AMONG = ("once", "twice", "scale", "stiffness")
"""What is freed without being asked for. Not play: on which side of it a joint lies only rows tell that stand in the order they were gone
to, and whatever else went on in that order, as heat does, looks like it."""


def identify_with_choice(robot: R, rows: Measurements, settings: Settings | None = None, among: Sequence[str] = AMONG) -> Identified[R]:
    """`identify` with the families of `settings`, and of those `among` the ones that the measurements ask for: the one least likely by
    chance first, until none is below `FALSE_ALARM`. Of a family that is not among them and asked for `findings` tell."""
    settings = settings or Settings()
    found = identify(robot, rows, settings)
    while True:
        asked = [w for w in worth_freeing(found) if not w.freed and w.family in among and w.chance < FALSE_ALARM and w.aic < 0.0]
        if not asked:
            return replace(found, findings=(*found.findings, *_not_freed(found)))
        best = min(asked, key=lambda w: (w.chance, w.aic))
        settings = replace(settings, free=(*settings.free, best.family))
        found = identify(robot, rows, settings)


def _not_freed(found: Identified[R]) -> list[Noted]:
    asked = [w for w in worth_freeing(found) if not w.freed and w.chance < FALSE_ALARM and w.aic < 0.0]
    return [noted("worth-freeing", "worth_freeing", w.family, w.chance, family=w.family, chance=w.chance) for w in asked]
