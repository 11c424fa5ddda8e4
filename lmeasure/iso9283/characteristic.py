"""A characteristic of a robot: its value, uncertainty and verdict.

Written to certificate.json as

    {"schema": "lmeasure.certificate/1",
     "characteristics": [{"name": "AP_p", "pose": "P1", "value": .., "unit": "mm", "u95": .., "capable": true, ...}, ...]}

one table per characteristic, as `Characteristic.as_dict` gives it: keys that do not apply are omitted (a path's characteristic has `path`
and no `pose`), `value`, `u95` and `capable` are always there, the last two null without a stated uncertainty of the measurement. Deviations
of speed (AV, RV) are in percent.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, NamedTuple, get_args

from lmeasure.core import MAX_LENGTH_MM, CertificationError
from lmeasure.text import Message, message

Verdict = Literal["conforms", "does not conform", "not decided"]
Rule = Literal["simple", "guarded"]


class CharacteristicKey(NamedTuple):
    """Key of a characteristic in a certificate: its name, its pose or path, and the part of that."""

    name: str
    pose: str | None = None
    path: str | None = None
    part: str | None = None

    @property
    def where(self) -> str:
        """Pose or path, and the part of it, for a person."""
        return " ".join(p for p in (self.pose, self.path, self.part) if p)

    def __str__(self) -> str:
        return f"{self.name} of {self.where}" if self.where else self.name


def key_of(figure: Mapping[str, Any]) -> CharacteristicKey:
    """The key of a table of certificate.json."""
    return CharacteristicKey(str(figure["name"]), *(None if figure.get(k) is None else str(figure[k]) for k in ("pose", "path", "part")))


@dataclass(frozen=True)
class Conformity:
    """A characteristic compared with a stated tolerance (JCGM 106).

    lower, upper: tolerance limits in the characteristic's unit, None without one; rule: simple acceptance (the value decides) or guarded
    acceptance (the value decides with U95 as guard band on both sides; between them there is no decision); verdict; probability of a
    characteristic within the limits, by a normal law of standard deviation U95 / 1.96 about the value.
    """

    lower: float | None
    upper: float | None
    rule: Rule
    verdict: Verdict
    probability: float


INFINITE = 1e4
"""Degrees of freedom that no coverage factor feels."""


@dataclass(frozen=True)
class Contribution:
    """A row of a result's budget (JCGM 100, 8.1; EA-4/02, 4.10): an input quantity whose estimate is zero, since known errors are
    corrected.

    source: its name; contribution: its standard uncertainty in the result, in the result's unit; u: standard uncertainty of the input in a
    unit, 1 and empty for a source with variables of several sizes; distribution; degrees_of_freedom: of u, None for a stated one; random:
    whether another run draws it anew.
    """

    source: Message | str
    contribution: float
    u: float = 1.0
    unit: str = ""
    distribution: Literal["normal", "rectangular", "drawn"] = "normal"
    degrees_of_freedom: float | None = None
    random: bool = False

    def as_dict(self, whole: float) -> dict[str, Any]:
        """The row of certificate.json; whole: standard uncertainty of the result."""
        row = {"source": str(self.source), "value": 0.0, "u": self.u, "unit": self.unit, "distribution": self.distribution}
        row |= {"sensitivity": self.contribution / self.u, "degrees_of_freedom": self.degrees_of_freedom}
        share = 100.0 * (self.contribution / whole) ** 2 if whole > 0.0 else 0.0
        return row | {"contribution": self.contribution, "share_percent": share}


@dataclass(frozen=True)
class Characteristic:
    """One result of a certificate.

    name: as ISO 9283:1998 writes it, _ for a subscript: AP_p; each module of `clauses` states its own. `_rot` marks rotation as a whole (an
    extension). pose, path: its part of the program; a distance or a posing has the pose "P2-P4". part: a part of that, such as "corner 2".
    clause: of ISO 9283:1998. value, unit; u95: half of the interval about the value that holds the characteristic of the true poses of
    these cycles with 95 %. u_random, u_systematic: standard uncertainties by the linear law from the counts (their rounding, new in each
    dwell, and their sub-count offset at zeroing: both drawn anew in another run) and from the rest, such as the calibration (shared by the
    run, and by others of that calibration); coverage_factor: u95 over their root sum of squares, None if that is zero. cycles: their
    number. capable: whether u95 is small enough for a verdict; limit_u95: that limit, in the unit. capable_alone: for a signed component,
    which has the verdict of its vector or of a tolerance: whether u95 is small enough beside the component itself; None for others.
    conformity: None unless a tolerance is stated. angles: convention of a component-wise angle. extension: not in the standard. excluded:
    reason for a value without a verdict (outside the instrument's zone); capable is then false. stated: False for a measurement of unstated
    uncertainty: u95 is then NaN, there is no verdict, and files have null. budget: rows of its standard uncertainty; bias: mean of its
    error and u_drawn: standard deviation of it by Monte Carlo, which contain the nonlinear part; both None without a linear law.
    """

    name: str
    clause: str
    value: float
    unit: str
    u95: float
    capable: bool
    cycles: int
    pose: str | None = None
    path: str | None = None
    part: str | None = None
    u_random: float | None = None
    u_systematic: float | None = None
    coverage_factor: float | None = None
    limit_u95: float | None = None
    capable_alone: bool | None = None
    conformity: Conformity | None = None
    angles: str | None = None
    extension: bool = False
    excluded: Message | None = None
    note: Message | None = None
    stated: bool = True
    budget: tuple[Contribution, ...] = ()
    bias: float | None = None
    u_drawn: float | None = None

    @property
    def key(self) -> CharacteristicKey:
        return CharacteristicKey(self.name, self.pose, self.path, self.part)

    @property
    def where(self) -> str:
        """Pose or path, and the part of it, for a person."""
        return self.key.where

    def with_budget(self, budget: tuple[Contribution, ...], u95: float) -> "Characteristic":
        """The same with these rows, and the standard uncertainties and coverage factor that follow."""
        random, systematic = (math.hypot(*(row.contribution for row in budget if row.random is kind)) for kind in (True, False))
        u = math.hypot(random, systematic)
        factor = u95 / u if u > 0.0 else None
        return replace(self, budget=budget, u95=u95, u_random=random, u_systematic=systematic, coverage_factor=factor)

    @property
    def degrees_of_freedom(self) -> float | None:
        """Return the degrees of freedom of the standard uncertainty, by Welch and Satterthwaite (JCGM 100, G.4.1); None where they are as
        good as infinite."""
        known = sum(row.contribution**4 / row.degrees_of_freedom for row in self.budget if row.degrees_of_freedom is not None)
        whole = math.hypot(*(row.contribution for row in self.budget)) ** 4
        return whole / known if whole < INFINITE * known else None

    def unstated(self) -> "Characteristic":
        """Return it for a measurement of unstated uncertainty: the value alone."""
        return replace(
            self, u95=math.nan, capable=False, capable_alone=None, u_random=None, u_systematic=None, coverage_factor=None, limit_u95=None,
            conformity=None, stated=False, budget=(), bias=None, u_drawn=None,
        )  # fmt: skip

    def as_dict(self) -> dict[str, Any]:
        """The table of certificate.json; see the module's text."""
        order = ["name", "pose", "path", "part", "value", "unit", "u95", "capable", "capable_alone"]
        names = order + [f.name for f in fields(self) if f.name not in order]
        out = {name: getattr(self, name) for name in names}
        if self.conformity is not None:
            out["conformity"] = {k: v for k, v in vars(self.conformity).items() if v is not None}
        if self.budget:
            u = math.hypot(*(row.contribution for row in self.budget))
            out |= {"u": u, "degrees_of_freedom": self.degrees_of_freedom, "budget": [row.as_dict(u) for row in self.budget]}
        else:
            del out["budget"]
        del out["stated"]
        reported = {k: str(v) if isinstance(v, Message) else v for k, v in out.items() if v is not None}
        return reported if self.stated else reported | {"u95": None, "capable": None}


@dataclass(frozen=True)
class CertificationSettings:
    """Settings of an evaluation, which become part of the certificate.

    Examples
    --------
    >>> lm.CertificationSettings(rule="guarded").capability
    0.25
    """

    align: bool = False
    """Whether the base frame is first fitted to the poses."""
    angles: str | None = None
    """Angle convention of component-wise angles; default: the program's, else the rig's."""
    tool_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Certified point of the tool, tool frame [mm]."""
    capability: float = 0.25
    """Largest ratio of U95 to a result for a verdict."""
    limit_angle_deg: float | None = 60.0
    """Largest pressure angle of the instrument's zone [deg]; None: no limit."""
    limit_u95_mm: float | None = None
    """Largest expanded uncertainty U95 of the position in the instrument's zone [mm]; None: no limit."""
    rule: Rule = "guarded"
    """Decision rule for tolerances: "simple" or "guarded" (JCGM 106)."""
    planes: int = 102
    """Number of planes normal to a path. With 4 k + 2, two of them are at the quarters of a line (`quarters`)."""
    still_mm: float = 0.2
    """Largest motion within a window [mm]."""
    trials: int = 2000
    """Number of Monte Carlo trials."""
    seed: int = 0
    """Seed of the Monte Carlo trials."""

    @property
    def quarters(self) -> bool:
        """Return whether planes are at the quarters of lines, between which velocities are taken (8.6.1)."""
        return self.planes % 4 == 2

    def __post_init__(self) -> None:
        if self.rule not in get_args(Rule):
            raise CertificationError(message("error.rule_must_be", rule=self.rule, options=" or ".join(get_args(Rule))))
        if not all(abs(v) <= MAX_LENGTH_MM for v in self.tool_offset_mm):
            raise CertificationError(
                message("error.tool_offset_mm_must", tool_offset_mm=list(self.tool_offset_mm), max_length_mm=MAX_LENGTH_MM)
            )
        for name, most in (("limit_angle_deg", 90.0), ("limit_u95_mm", MAX_LENGTH_MM)):
            limit = getattr(self, name)
            if limit is not None and not 0.0 < limit <= most:
                raise CertificationError(message("error.must_be_more_than", name=name, limit=limit, most=most))
        if self.seed < 0 or not math.isfinite(self.capability):
            raise CertificationError(message("error.seed_capability_must_be", seed=self.seed, capability=self.capability))
