"""What a robot.toml states of a parallel robot's workspace besides its joints' limits (`limits.checked`)."""

from typing import Annotated

from pydantic import Field

from lmeasure.io import Strict
from lmeasure.robots.file_fields import Length

Cone = Annotated[float, Field(gt=0.0, le=180.0)]


class Limits(Strict):
    """Angles are of legs to the base's z and to the platform's; gaps between neighbouring carriages of one circle, in the order of legs."""

    least_gap_deg: Annotated[float, Field(ge=0.0, le=180.0)] | None = None
    """Least angle between neighbouring carriages."""
    most_gap_deg: Annotated[float, Field(ge=0.0, le=180.0)] | None = None
    """Largest angle between neighbouring carriages."""
    base_cone_deg: Cone | None = None
    """Largest angle of a leg to the base's z."""
    platform_cone_deg: Cone | None = None
    """Largest angle of a leg to the platform's z."""
    singular: Annotated[float, Field(ge=0.0, lt=1.0)] = 1e-3
    """Least distance from a singular pose: smallest over largest singular value of the rows."""
    mass_mm: tuple[Length, Length, Length] | None = None
    """Centre of mass, in the flange's frame: must stay over the polygon of the legs' lower ends."""
