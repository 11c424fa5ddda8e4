"""What a robot.toml states of a parallel robot's workspace besides its joints' limits (`limits.checked`)."""

from typing import Annotated

from pydantic import Field

from lmeasure.io import Strict
from lmeasure.robots.file_fields import Length

Cone = Annotated[float, Field(gt=0.0, le=180.0)]


class Limits(Strict):
    """Limits of the workspace. Neighbouring carriages are those of one circular guide, in the order of the legs."""

    least_gap_deg: Annotated[float, Field(ge=0.0, le=180.0)] | None = None
    """Smallest angle between neighbouring carriages."""
    most_gap_deg: Annotated[float, Field(ge=0.0, le=180.0)] | None = None
    """Largest angle between neighbouring carriages."""
    base_cone_deg: Cone | None = None
    """Largest angle between a leg and the base's z."""
    platform_cone_deg: Cone | None = None
    """Largest angle between a leg and the platform's z."""
    singular: Annotated[float, Field(ge=0.0, lt=1.0)] = 1e-3
    """Smallest allowed ratio of the smallest to the largest singular value of the Jacobian."""
    mass_mm: tuple[Length, Length, Length] | None = None
    """Centre of mass in the flange's frame. It must stay above the polygon of the legs' lower ends."""
