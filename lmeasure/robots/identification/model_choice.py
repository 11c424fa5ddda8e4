"""What is worth freeing, decided by the measurements: families of parameters are freed one after the other while a test asks for it."""

from collections.abc import Sequence
from dataclasses import replace

from lmeasure.robots.identification.hold_out import Worth, unseen_halves, worth_freeing
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
    """`identify` with the families of `settings`, and of those `among` the ones that the measurements ask for.

    The one least likely by chance is freed first, until none is below `FALSE_ALARM`. A family that predicts unseen halves of the
    workspace worse stays out (`hold_out.Unseen`). `findings` name the families that the measurements ask for and that are not freed.
    """
    settings = settings or Settings()
    found = identify(robot, rows, settings)
    while True:
        asked = sorted((w for w in worth_freeing(found) if not w.freed and w.chance < FALSE_ALARM and w.aic < 0.0), key=_least_likely)
        unseen = {w.family: unseen_halves(found, w.family) for w in asked if w.family in among}
        best = next((name for name, halves in unseen.items() if halves.good), None)
        if best is None:
            notes = [_noted(w) for w in asked if w.family not in unseen]
            if unseen:
                families, times = ", ".join(unseen), max(u.times for u in unseen.values())
                notes.append(noted("worth-freeing", "worse_unseen", families, times, families=families, times=times))
            return replace(found, findings=(*found.findings, *notes))
        settings = replace(settings, free=(*settings.free, best))
        found = identify(robot, rows, settings)


def _least_likely(worth: Worth) -> tuple[float, float]:
    return worth.chance, worth.aic


def _noted(worth: Worth) -> Noted:
    return noted("worth-freeing", "worth_freeing", worth.family, worth.chance, family=worth.family, chance=worth.chance)
