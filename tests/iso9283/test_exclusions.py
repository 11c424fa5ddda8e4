"""What gets no verdict, by parts and errors made by hand: each limit on both sides, the order of reasons, and what hangs on counts."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from synthetic_trajectories import trajectory_of

from lmeasure.iso9283 import CertificationSettings
from lmeasure.iso9283.clause import IsoTest, SampleErrors
from lmeasure.iso9283.evaluation import Exclusions, exclusions, largest_radius_95
from lmeasure.iso9283.figure import Subject
from lmeasure.text import message
from lmeasure.trajectory import PoseErrors

TRAJECTORY = trajectory_of(np.arange(100) / 10.0, np.zeros((100, 3)))
ISOTROPIC_95 = 2.7954835
"""Radius of a sphere about a normal law of three alike axes that holds 95 % of it, in standard deviations."""


def of(u_mm: float, n: int = 3) -> PoseErrors:
    """Errors of n positions by u_mm along each axis, of one of them; the others hardly err but turn the more."""
    own = np.tile(np.diag([1.0, 1.0, 1.0, 1e-6, 1e-6, 1e-6]), (n, 1, 1))
    own[-1] = np.diag([0.0, 0.0, 0.0, u_mm, u_mm, u_mm])
    return PoseErrors.of(own, np.zeros((n, 6, 0)))


@dataclass(frozen=True, kw_only=True)
class ZoneTest(IsoTest):
    """A test that is held against the zone by errors of its own, or by the laws'."""

    by: tuple[PoseErrors, ...] = ()

    def excludable(self, errors: SampleErrors) -> PoseErrors | None:
        """See `IsoTest`."""
        return errors(np.arange(3)) if self.by else None


def held(kind: Any, name: str, angle_deg: float = 30.0, start: float = 0.0, **more: Any) -> ZoneTest:
    return ZoneTest(subject=Subject(kind, name), windows=((start, start + 1.0),), angle_deg=angle_deg, **more)


def requested(*tests: IsoTest, laws: Any = (), trajectory: Any = TRAJECTORY, **chosen: Any) -> Exclusions:
    return exclusions(tests, trajectory, CertificationSettings(**chosen), laws)


def test_a_radius_holds_95_percent_of_the_position_that_errs_most() -> None:
    assert largest_radius_95(of(0.02)) == pytest.approx(ISOTROPIC_95 * 0.02, rel=1e-5)


def test_the_zone_ends_beyond_its_largest_angle() -> None:
    found = requested(held("pose", "A", 60.0), held("pose", "B", 60.01), held("path", "C", math.nan))
    assert {s.name: str(why) for s, why in found.reasons.items()} == {"B": "worst pressure angle 60.0 deg. The zone ends at 60 deg"}
    assert [str(f) for f in found.findings] == ["path C: its pressure angles are unknown, so it is not checked in the zone"]
    # what has no windows is not held against it, and without a limit nothing is
    assert requested(ZoneTest(subject=Subject("distance", "A-B"), angle_deg=80.0)) == Exclusions({}, ())
    assert requested(held("pose", "B", 80.0), held("path", "C", math.nan), limit_angle_deg=None) == Exclusions({}, ())


@pytest.mark.parametrize(("u_mm", "reported"), [(0.0999 / ISOTROPIC_95, None), (0.1001 / ISOTROPIC_95, "0.1001")])
@pytest.mark.parametrize("first", [True, False])
def test_the_zone_ends_beyond_its_largest_radius_by_any_law(u_mm: float, reported: str | None, first: bool) -> None:
    few, many = (lambda _: of(0.001)), (lambda _: of(u_mm))
    tests = held("pose", "A", by=(of(0.0),)), held("pose", "B"), held("pose", "C", 70.0, by=(of(0.0),))
    found = requested(*tests, laws=(many, few) if first else (few, many), limit_u95_mm=0.1)
    radius = {} if reported is None else {"A": f"U95 of a position {reported} mm. The zone ends at 0.1 mm"}
    # one that is outside already keeps its reason
    assert {s.name: str(why) for s, why in found.reasons.items()} == radius | {
        "C": "worst pressure angle 70.0 deg. The zone ends at 60 deg"
    }
    assert requested(*tests[:2], laws=(many,)) == Exclusions({}, ())


def test_reasons_stand_in_the_order_of_certificates_whatever_they_are() -> None:
    kinds = ("posing", "path", "pose", "settling", "compliance")
    tests = [held(kind, f"{kind} {i}", 70.0 if i else 30.0, by=(of(0.0),)) for i in (1, 0) for kind in kinds]
    found = requested(*tests, laws=(lambda _: of(1.0),), limit_u95_mm=0.1)
    ordered = [f"{kind} {i}" for kind in ("pose", "path", "compliance", "settling", "posing") for i in (1, 0)]
    assert [s.name for s in found.reasons] == ordered


def test_a_figure_has_the_first_reason_of_what_it_needs() -> None:
    one, other = Subject("pose", "A"), Subject("pose", "B")
    found = Exclusions(
        {one: message("zone.angle", angle_deg=70.0, limit_deg=60.0), other: message("zone.radius", u95_mm=1.0, limit_mm=0.1)}
    )
    assert str(found.reason((other, one))) == "pose A: worst pressure angle 70.0 deg. The zone ends at 60 deg"
    assert str(found.reason((other,))) == "pose B: U95 of a position 1 mm. The zone ends at 0.1 mm"
    assert found.reason((Subject("path", "A"),)) is None
    assert found.reason(()) is None


def test_what_hangs_on_counts_that_may_be_lost_gets_no_verdict() -> None:
    """Whatever its angle is; where no sample of its windows does, it gets one."""
    cause = TRAJECTORY.cause.copy()
    lost = message("counts.suspected", step="about 200 counts of ch3")
    cause[50:] = message("cause.without", cause=lost)
    cause[:5] = message("cause.without", cause="")
    trajectory = type(TRAJECTORY)(**{**vars(TRAJECTORY), "cause": cause})
    tests = held("pose", "A", start=1.0), held("pose", "B", start=4.5), held("pose", "C", 70.0, start=6.0), held("pose", "D", start=3.85)
    found = requested(*tests, trajectory=trajectory)
    assert {s.name: str(why) for s, why in found.reasons.items()} == {
        "B": "suspected lost counts: about 200 counts of ch3",
        "C": "suspected lost counts: about 200 counts of ch3",
    }
    assert requested(*tests[:1], trajectory=trajectory) == Exclusions({}, ())
