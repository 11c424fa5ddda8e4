"""Which tests of ISO 9283:1998 a robot is asked to do, and how: speeds, loads, rests and numbers of cycles."""

import math
from dataclasses import dataclass, field

from lmeasure.core import CONVENTIONS, CertificationError

TESTS = ("pose", "approach", "stabilisation", "drift", "path", "reorientation", "posing", "compliance", "weaving")
CYCLES = {"pose": 30, "approach": 30, "stabilisation": 3, "path": 10, "reorientation": 10, "posing": 3, "compliance": 3, "weaving": 3}
"""How often each test is done; the drift test has groups of ten cycles."""
MOST_CYCLES = 10_000
LONGEST_DRIFT_S = 100.0 * 3600.0


@dataclass(frozen=True)
class Tests:
    """What is tested, and how.

    tests: names of `TESTS`; quaternion (4,): the tool's orientation, base frame; speed_mm_s: rated speed between poses, path_speed_mm_s: on
    paths; speeds_percent of them and loads_kg: conditions of the pose and path tests, the first for all others; dwell_s: rest at a pose
    that is measured, of which the first settle_s are left out; cycles: other numbers than the standard's `CYCLES`; drift_s: how long the
    drift test lasts, drift_every_s: from group to group; weave_mm: stroke and way of one weave; limit_band_mm:
    about a pose at rest, within which the robot has arrived (settling and posing); angles: convention of component-wise angles.
    """

    __test__ = False  # no test of pytest's

    tests: tuple[str, ...] = TESTS
    quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    speed_mm_s: float = 1000.0
    path_speed_mm_s: float = 500.0
    speeds_percent: tuple[float, ...] = (100.0, 50.0, 10.0)
    loads_kg: tuple[float, ...] = (0.0,)
    dwell_s: float = 1.5
    settle_s: float = 0.5
    cycles: dict[str, int] = field(default_factory=dict)
    drift_s: float = 8.0 * 3600.0
    drift_every_s: float = 600.0
    weave_mm: tuple[float, float] = (10.0, 10.0)
    limit_band_mm: float = 0.1
    angles: str | None = None

    def __post_init__(self) -> None:
        for name in (*self.tests, *self.cycles):
            if name not in TESTS:
                raise CertificationError(f"there is no test {name!r}; known: {', '.join(TESTS)}")
        for what, given in (("test", self.tests), ("speed", self.speeds_percent), ("load", self.loads_kg)):
            if not given:
                raise CertificationError("there must be a test, a speed and a load at least")
            if len(set(given)) < len(given):
                raise CertificationError(f"a {what} is given twice: {', '.join(map(str, given))}")
        if not abs(math.hypot(*self.quaternion) - 1.0) <= 1e-6:
            raise CertificationError(f"quaternion {', '.join(f'{q:g}' for q in self.quaternion)}: is not of length 1")
        if self.angles is not None and self.angles not in CONVENTIONS:
            raise CertificationError(f"angles: {self.angles!r} is not one of {', '.join(CONVENTIONS)}")
        positive = (
            self.speed_mm_s,
            self.path_speed_mm_s,
            *self.speeds_percent,
            self.drift_s,
            self.drift_every_s,
            *self.weave_mm,
            self.limit_band_mm,
        )
        if not all(0.0 < v < math.inf for v in positive) or not all(0.0 <= v < math.inf for v in self.loads_kg):
            raise CertificationError("speeds, times and lengths must be finite and more than 0, loads 0 or more")
        if not 0.0 <= self.settle_s < self.dwell_s < math.inf:
            rest = f"a rest of {self.dwell_s:g} s at each pose (--dwell)"
            raise CertificationError(f"{rest} leaves nothing to measure: the first {self.settle_s:g} s are left out")
        if any(not 2 <= n <= MOST_CYCLES for n in self.cycles.values()):
            raise CertificationError(f"each test needs two cycles at least and has {MOST_CYCLES} at most")
        if self.drift_s > LONGEST_DRIFT_S:
            raise CertificationError(f"a drift test of {self.drift_s / 3600.0:g} h is too long: {LONGEST_DRIFT_S / 3600.0:g} h at most")
        if max(self.speeds_percent) > 100.0:
            raise CertificationError(f"a speed of {max(self.speeds_percent):g} % is more than the rated one")

    @property
    def first(self) -> dict[str, float]:
        """The first condition, that of all tests but pose and path."""
        return {"speed_percent": self.speeds_percent[0], "load_kg": self.loads_kg[0]}

    def at(self, rated_mm_s: float) -> float:
        """A rated speed at the first condition [mm/s]."""
        return 0.01 * self.speeds_percent[0] * rated_mm_s

    def count(self, test: str) -> int:
        """How many cycles a test has."""
        return self.cycles.get(test, CYCLES[test])
