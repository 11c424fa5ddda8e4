"""What gets no verdict, and why: parts outside the instrument's zone, and parts that hang on counts that may be wrong."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from lmeasure.accuracy import exact_radius_95
from lmeasure.iso9283.clause import IsoTest, SampleErrors
from lmeasure.iso9283.figure import Subject
from lmeasure.iso9283.settings import CertificationSettings
from lmeasure.text import Finding, finding, recognised, within
from lmeasure.trajectory import SUSPECTED, PoseErrors, Trajectory, window

ORDER = ("pose", "path", "compliance", "settling", "posing")
"""Of the kinds of parts, as certificates list them."""


class Exclusions(NamedTuple):
    """Why parts get no verdict, and what could not be held against the zone."""

    reasons: Mapping[Subject, Finding]
    findings: tuple[Finding, ...] = ()

    def reason(self, needs: Sequence[Subject]) -> Finding | None:
        """Why a figure of these parts gets no verdict."""
        first = next((s for s in self.reasons if s in needs), None)
        return None if first is None else finding("excluded.part", part=first.said, reason=self.reasons[first])


def exclusions(
    tests: Sequence[IsoTest], trajectory: Trajectory, settings: CertificationSettings, laws: Sequence[SampleErrors]
) -> Exclusions:
    """Of tests with windows, by the worst pressure angle met and the radius that holds 95 % of a position by any of the laws of errors, and
    by samples that hang on counts suspected lost."""
    held = sorted((t for t in tests if t.windows), key=lambda t: ORDER.index(t.subject.kind))
    reasons: dict[Subject, Finding] = {}
    findings = []
    limit, radius = settings.limit_angle_deg, settings.limit_u95_mm
    for test in held:
        if limit is not None and test.angle_deg > limit:
            reasons[test.subject] = finding("zone.angle", angle_deg=test.angle_deg, limit_deg=limit)
        elif limit is not None and np.isnan(test.angle_deg):
            findings.append(finding("zone.unknown", part=test.subject.said))
    for test in held:
        errors = [] if radius is None or test.subject in reasons else [test.excludable(law) for law in laws]
        u95 = next((u for e in errors if e is not None and (u := largest_radius_95(e)) > (radius or 0.0)), None)
        if u95 is not None:
            reasons[test.subject] = finding("zone.radius", u95_mm=u95, limit_mm=radius)
    reasons = {subject: reasons[subject] for subject in sorted(reasons, key=[t.subject for t in held].index)}
    suspected = {cause: found for cause in set(trajectory.cause.tolist()) if (found := within(cause, SUSPECTED)) is not None}
    for test in held if suspected else ():
        windows = [window(trajectory, *w, str(test.subject.said)) for w in test.windows]
        seen = {cause for samples in windows for cause in trajectory.cause[samples].tolist()} & suspected.keys()
        if seen:
            # sealed folders hold the values as they are printed
            step = str(suspected[min(seen, key=str)].values["step"])
            reasons[test.subject] = finding(SUSPECTED, step=recognised(step) or step)
    return Exclusions(reasons, tuple(findings))


def largest_radius_95(errors: PoseErrors) -> float:
    """Radius of the sphere [mm] that holds 95 % of the error of a position, of the pose where it is the largest."""
    covariance = errors.covariance[:, 3:, 3:]
    largest = covariance[int(np.argmax(np.trace(covariance, axis1=1, axis2=2)))]
    return exact_radius_95(np.linalg.eigvalsh(largest))
