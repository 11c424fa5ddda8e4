"""What of an evaluation can be chosen."""

import math
from dataclasses import dataclass
from typing import get_args

from lmeasure.core import MAX_LENGTH_MM, CertificationError
from lmeasure.iso9283.characteristic import Rule


@dataclass(frozen=True)
class CertificationSettings:
    """What of an evaluation can be chosen; all of it belongs in the certificate.

    align: fit the base frame to the poses before anything else; tool_offset_mm: the point of the tool that is certified, in the tool
    frame; angles: convention of component-wise angles, else the program's, else the rig's; capability: largest u95 as a fraction of the
    characteristic; limit_angle_deg, limit_u95_mm: of the instrument's zone, None for no limit; rule: of decision on tolerances; planes:
    normal to a path; still_mm: largest motion within a window; trials, seed: of Monte Carlo. CertificationError for what cannot be meant.
    """

    align: bool = False
    angles: str | None = None
    tool_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    capability: float = 0.25
    limit_angle_deg: float | None = 60.0
    limit_u95_mm: float | None = None
    rule: Rule = "simple"
    planes: int = 102
    """Of 4 k + 2 two stand at a quarter and at three quarters of a line (`quarters`)."""
    still_mm: float = 0.2
    trials: int = 2000
    seed: int = 0

    @property
    def quarters(self) -> bool:
        """Whether planes stand at the quarters of lines, between which velocities are taken (8.6.1).

        Earlier certificates state 100: the nearest stood at 25.5 and 74.5 %, and of a robot that was still speeding up there AV was 0.2 %
        off.
        """
        return self.planes % 4 == 2

    def __post_init__(self) -> None:
        if self.rule not in get_args(Rule):
            raise CertificationError(f"rule = {self.rule!r}: must be {' or '.join(get_args(Rule))}")
        if not all(abs(v) <= MAX_LENGTH_MM for v in self.tool_offset_mm):
            raise CertificationError(f"tool_offset_mm = {list(self.tool_offset_mm)}: must be finite, at most {MAX_LENGTH_MM:g} mm")
        for name, most in (("limit_angle_deg", 90.0), ("limit_u95_mm", MAX_LENGTH_MM)):
            limit = getattr(self, name)
            if limit is not None and not 0.0 < limit <= most:
                raise CertificationError(f"{name} = {limit:g}: must be more than 0 and at most {most:g}")
        if self.seed < 0 or not math.isfinite(self.capability):
            raise CertificationError(f"seed = {self.seed}, capability = {self.capability}: must be numbers from 0")
