"""What of an evaluation can be chosen."""

from dataclasses import dataclass
from typing import Any

from lmeasure.certification.characteristic import Rule


@dataclass(frozen=True)
class Settings:
    """What of an evaluation can be chosen; all of it belongs in the certificate.

    align: fit the base frame to the poses before anything else; tool_offset_mm: the point of the tool that is certified, in the tool
    frame; angles: convention of component-wise angles, else the program's, else the rig's; capability: largest u95 as a fraction of the
    characteristic; limit_angle_deg, limit_u95_mm: of the instrument's zone, None for no limit; rule: of decision on tolerances; planes:
    normal to a path; still_mm: largest motion within a window; trials, seed: of Monte Carlo.
    """

    align: bool = False
    angles: str | None = None
    tool_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    capability: float = 0.25
    limit_angle_deg: float | None = 60.0
    limit_u95_mm: float | None = None
    rule: Rule = "simple"
    planes: int = 100
    still_mm: float = 0.2
    trials: int = 2000
    seed: int = 0

    def as_dict(self) -> dict[str, Any]:
        """For certificate.json."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in vars(self).items() if v is not None}
