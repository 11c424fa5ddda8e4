"""Channels of a rig: its cables as it states them, and sensors beside them at its observation points."""

import math

from lmeasure.core import FloatArray
from lmeasure.rig import GUIDE, PLACE, TABLE, Cable, Parameter, Rig, attachment_names, parameter_of
from reference.cable import CableLength
from reference.inclination import Inclination
from reference.swivel import TURN, SwivelAngle

UNKNOWN_MM = 1e4
"""Prior standard uncertainty of a length that was out when a counter was zeroed nobody knows where."""
UNKNOWN_DEG = 360.0 / math.sqrt(12.0)
"""And of an angle: anywhere on the circle."""


def cable_lengths(rig: Rig, zeroed_at: FloatArray | None = None, cables: tuple[Cable, ...] | None = None) -> list[CableLength]:
    """The rig's cables, or those given, whose counters were zeroed at a pose (7,); without one it is unknown what was out then."""
    out = []
    for c in rig.cable if cables is None else cables:
        drum = rig.point(c.from_point).drum
        count = drum.count_length_mm / drum.scale
        phase = 0.0 if drum.zero_exact else count / math.sqrt(12.0)
        zero = Parameter(f"{c.channel}.zero_mm", 0.0, UNKNOWN_MM if zeroed_at is None else phase)
        own = (*(parameter_of(rig, p.name(c)) for p in TABLE), zero)
        out.append(CableLength(c.channel, own, count**2 / 12.0, drum.count_length_mm, drum.counts_per_revolution, zeroed_at))
    return out


def swivel_angle(
    rig: Rig, channel: str, point: str, to: str, *, counts_per_revolution: int, zero_deg: float = 0.0, u_zero_deg: float | None = None
) -> SwivelAngle:
    """An encoder on the swivel pulley of one of the rig's observation points, whose cable leads to one of its attachment points; zero_deg:
    the swivel angle at count 0, of standard uncertainty u_zero_deg, unknown where that is None."""
    names = (*(f"{point}.{key}" for key in (*PLACE, *GUIDE)), *attachment_names(to))
    zero = Parameter(f"{channel}.zero_deg", zero_deg, UNKNOWN_DEG if u_zero_deg is None else u_zero_deg, "deg")
    return SwivelAngle(channel, (*(parameter_of(rig, name) for name in names), zero), (TURN / counts_per_revolution) ** 2 / 12.0)


def rig_inclination(
    channel: str,
    axis: tuple[float, float, float],
    *,
    counts_per_revolution: int,
    zero_deg: float = 0.0,
    u_zero_deg: float | None = None,
    u_axis: float = 0.0,
    up: tuple[float, float, float] = (0.0, 0.0, 1.0),
    u_up: float = 0.0,
) -> Inclination:
    """An axis of an inclinometer on the tool: axis in the tool frame, of length 1 and components uncertain by u_axis; up: against gravity
    in the base frame, uncertain by u_up, which all inclinometers share."""
    own = [Parameter(f"{channel}.axis_{c}", v, u_axis, "") for c, v in zip("xyz", axis, strict=True)]
    own += [Parameter(f"up_{c}", v, u_up, "") for c, v in zip("xyz", up, strict=True)]
    zero = Parameter(f"{channel}.zero_deg", zero_deg, UNKNOWN_DEG if u_zero_deg is None else u_zero_deg, "deg")
    return Inclination(channel, (*own, zero), (TURN / counts_per_revolution) ** 2 / 12.0)
