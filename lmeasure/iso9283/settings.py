"""Settings of an evaluation."""

import math
from dataclasses import dataclass
from typing import get_args

from lmeasure.core import MAX_LENGTH_MM, CertificationError
from lmeasure.iso9283.characteristic import Rule
from lmeasure.text import message


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
        """Whether planes stand at the quarters of lines, between which velocities are taken (8.6.1)."""
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
