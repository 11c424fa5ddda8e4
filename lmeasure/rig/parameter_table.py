"""The one table of the parameters that a cable has: every other place that needs one asks here.

A further parameter of cables is a row of `TABLE`, its key in `rig`, and its derivative in `kernels.cable`; or, where a rig seldom has it,
a row of `FURTHER`, its key, and its law in `sensors.imperfect_parts`.
"""

import math
from dataclasses import dataclass
from enum import StrEnum

from lmeasure.kernels import ALPHA, ATTACHMENT as ATTACHMENT_COLUMN, AXIAL, BASE, BETA, RADIUS, TANGENT, TRAVEL
from lmeasure.rig.points_and_drums import Cable


class Owner(StrEnum):
    """What of a rig a cable's parameter belongs to. Of a drum the observation point's name is the name."""

    POINT = "observation point"
    DRUM = "drum"
    ATTACHMENT = "attachment point"
    SENSOR = "sensor"


@dataclass(frozen=True, kw_only=True)
class CableParameter:
    """A kind of parameter of a cable.

    key: after the owner's name, that of a value in a calibration record; group: what `--solve` calls it.
    default_u: prior standard uncertainty of a nominal value that states none (a drawing, a tape measure, a protractor); assumed_u: of one
    in the rig's `assumed` list, which nobody measured. column: where the kernels' rows have it, if they do.
    """

    key: str
    owner: Owner
    group: str
    default_u: float
    assumed_u: float
    column: int | None
    stored: str = ""
    """Its key in rig.toml, where that is another; index: which of several numbers there."""
    index: int | None = None
    stated: str = ""
    """The key of its standard uncertainty, where that is another than u_ and the key."""
    inverse: str = ""
    """A key of rig.toml that says the same the other way round: what is uncertain of it is uncertain of the parameter."""
    per_revolution: bool = False
    """Whether the kernels' rows have it per count, as its share of a drum's revolution."""
    unsigned: bool = False
    """Whether its sign means nothing."""

    @property
    def unit(self) -> str:
        """mm, deg, or nothing."""
        return next((unit for unit in ("mm", "deg") if self.key.endswith(f"_{unit}")), "")

    @property
    def factor(self) -> float:
        """What the kernels have for one unit: radians of a degree."""
        return math.radians(1.0) if self.unit == "deg" else 1.0

    def name(self, cable: Cable) -> str:
        """What a calibration record calls it."""
        return f"tool.{cable.to_point}.{self.key}" if self.owner is Owner.ATTACHMENT else f"{cable.from_point}.{self.key}"


def _place(axis: str, column: int) -> CableParameter:
    return CableParameter(
        key=f"{axis}_mm", owner=Owner.POINT, group="position", default_u=30.0, assumed_u=300.0, column=column,
        stored="position_mm", index="xyz".index(axis), stated="u_position_mm",
    )  # fmt: skip


def _attachment(axis: str, column: int) -> CableParameter:
    return CableParameter(
        key=f"{axis}_mm", owner=Owner.ATTACHMENT, group="attachment", default_u=0.5, assumed_u=20.0, column=column,
        index="xyz".index(axis), stated="u_attachment_mm",
    )  # fmt: skip


def _guide(angle: str, column: int, assumed_u: float) -> CableParameter:
    return CableParameter(
        key=f"guide_{angle}_deg", owner=Owner.POINT, group="guide", default_u=5.0, assumed_u=assumed_u,
        column=column, stated="u_guide_deg",
    )  # fmt: skip


TABLE = (
    _place("x", BASE),
    _place("y", BASE + 1),
    _place("z", BASE + 2),
    _guide("alpha", ALPHA, 26.0),  # anywhere within +-45 degrees
    _guide("beta", BETA, 104.0),  # anywhere on the circle: 360/sqrt(12)
    CableParameter(
        key="pulley_radius_mm", owner=Owner.POINT, group="radius", default_u=1.0, assumed_u=10.0,
        column=RADIUS, unsigned=True,
    ),
    CableParameter(
        key="scale", owner=Owner.DRUM, group="scale", default_u=0.01, assumed_u=0.3, column=None,
        inverse="count_length_mm",
    ),
    CableParameter(
        key="tangent_length_mm", owner=Owner.DRUM, group="tangent", default_u=5.0, assumed_u=60.0,
        column=TANGENT,
    ),
    CableParameter(
        key="axial_offset_mm", owner=Owner.DRUM, group="axial", default_u=5.0, assumed_u=20.0,
        column=AXIAL,
    ),
    _attachment("x", ATTACHMENT_COLUMN),
    _attachment("y", ATTACHMENT_COLUMN + 1),
    _attachment("z", ATTACHMENT_COLUMN + 2),
    CableParameter(
        key="groove_pitch_mm", owner=Owner.DRUM, group="pitch", default_u=0.05, assumed_u=1.0,
        column=TRAVEL, per_revolution=True,
    ),
)  # fmt: skip
"""In the order of `kernels.layout.PARAMETERS`."""


def _pair(key: str, owner: Owner, group: str, *, u: float, suffixes: tuple[str, str], unit: str = "mm") -> tuple[CableParameter, ...]:
    """Two components that rig.toml keeps in one list."""
    return tuple(
        CableParameter(
            key=f"{key}_{suffix}_{unit}",
            owner=owner,
            group=group,
            default_u=u,
            assumed_u=10.0 * u,
            column=None,
            stored=f"{key}_{unit}",
            index=i,
            stated=f"u_{key}_{unit}",
        )
        for i, suffix in enumerate(suffixes)
    )


FURTHER = (
    *_pair("run_out", Owner.DRUM, "run-out", u=0.05, suffixes=("cos", "sin")),
    *_pair("pulley_eccentricity", Owner.POINT, "eccentricity", u=0.1, suffixes=("cos", "sin")),
    CableParameter(
        key="swivel_offset_mm", owner=Owner.POINT, group="offset", default_u=0.5, assumed_u=5.0, column=None,
    ),
    CableParameter(
        key="cable_oversize_mm", owner=Owner.DRUM, group="diameter", default_u=0.1, assumed_u=0.5,
        column=None,
    ),
    CableParameter(
        key="backlash_counts", owner=Owner.DRUM, group="backlash", default_u=2.0, assumed_u=20.0, column=None,
    ),
)  # fmt: skip
"""What a rig need not have, 0 where it is not given: in the order of `sensors.imperfect_parts`, which has their laws."""

TILT = _pair("swivel_tilt", Owner.POINT, "tilt", u=0.3, suffixes=("alpha", "beta"), unit="deg")
"""What is added to the guide's angles, whose derivatives are its own; 0 where it is not given."""
