"""Drum of a rig file from a mechanic's measurements on a grooved drum (thesis Rashoyan 2021, 5.5, figures 5.19 and 5.20).

The cable is fastened at a distance g from the drum's end face, is wound on over K counts until the robot is at the pose where the counters
are zeroed, and runs from there to a pulley with a fixed axis, a centre distance away, whose plane of symmetry is C from that end face. With
N counts per turn, drum radius R1, pulley radius R2, groove pitch t_m, centre distance a:

    turn       N c = hypot(2 pi R1, t_m),  groove angle  tan(gamma) = t_m/(2 pi R1)
    engaging   gamma1 = arcsin(R2/a), gamma2 = arccos((R1 - R2)/a): the drum turns by gamma3 = gamma2 - gamma1 until the cable is tangent,
               K0 = N gamma3/(2 pi) counts, and the pay-out point has gone t0 = R1 gamma3 tan(gamma) along the axis
    winding    t1 = (K - K0) t_m/N
    tangent    |E_C B_H| = a sin(gamma2) = sqrt(a^2 - (R1 - R2)^2)
    offset     |E_1 E_C| = C - g - t0 - t1

Corrected against the print: the tangent is a sin(gamma2), not a cos(gamma2); the sum of squares gives |E_1 B_H|. As t0 = K0 t_m/N, the
offset is C - g - K t_m/N: the radii and the centre distance do not enter it.
"""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from lmeasure.core import FileFormatError, RigError
from lmeasure.io import Name, Strict, Whole, checked, files, of_key
from lmeasure.rig.points_and_drums import Length, NotNegative, Positive
from lmeasure.rig.rig import Rig, rig_from_dict
from lmeasure.text import message

AGREEMENT = 0.01  # relative to the cable of a turn: larger differences between radius and count length contradict each other


class DrumMeasurement(Strict):
    """Measured dimensions of the drum of one observation point.

    Radii are to the middle of the cable. State `drum_radius_mm` or `count_length_mm`. If you state both, `count_length_mm` is used,
    and the radius must agree with it within 1 %.

    Examples
    --------
    >>> drum = lm.DrumMeasurement(
    ...     point="B1", counts_per_revolution=6000, groove_pitch_mm=1.0, count_length_mm=0.012, fixed_pulley_radius_mm=20.0,
    ...     centre_distance_mm=180.0, pulley_plane_mm=40.0, cable_end_mm=5.0, full_wind_counts=60000.0,
    ... )
    >>> lm.with_drums(rig, (drum,)).point("B1").drum.axial_offset_mm
    25.0
    """

    point: Name
    """Observation point of the drum."""
    counts_per_revolution: Annotated[Whole, Field(gt=0, le=2**32)]
    """Encoder counts per turn of the drum (N)."""
    groove_pitch_mm: Positive
    """Distance from groove to groove (t_m): ruler over ten grooves, divided by ten."""
    drum_radius_mm: Positive | None = None
    """Drum radius (R1): half the diameter over the wound cable, minus half the cable's thickness."""
    count_length_mm: Positive | None = None
    """Cable length per count (c): a known length pulled out, divided by the counts."""
    fixed_pulley_radius_mm: Positive
    """Radius of the fixed pulley (R2): groove bottom plus half the cable's thickness."""
    centre_distance_mm: Positive
    """Perpendicular distance between the axes of drum and fixed pulley (a)."""
    pulley_plane_mm: Length
    """Axial distance from the drum's end face to the middle plane of the fixed pulley (C)."""
    cable_end_mm: NotNegative
    """Axial distance from the same end face to the fastened end of the cable (g)."""
    full_wind_counts: Annotated[float, Field(gt=0, le=1e12)]
    """Counts to wind the cable from its end until it is taut at the zero pose (K)."""
    u_groove_pitch_mm: NotNegative = 0.0
    """Standard uncertainty of `groove_pitch_mm`."""
    u_drum_radius_mm: NotNegative = 0.0
    """Standard uncertainty of `drum_radius_mm`."""
    u_count_length_mm: NotNegative = 0.0
    """Standard uncertainty of `count_length_mm`."""
    u_fixed_pulley_radius_mm: NotNegative = 0.0
    """Standard uncertainty of `fixed_pulley_radius_mm`."""
    u_centre_distance_mm: NotNegative = 0.0
    """Standard uncertainty of `centre_distance_mm`."""
    u_pulley_plane_mm: NotNegative = 0.0
    """Standard uncertainty of `pulley_plane_mm`."""
    u_cable_end_mm: NotNegative = 0.0
    """Standard uncertainty of `cable_end_mm`."""
    u_full_wind_counts: NotNegative = 0.0
    """Standard uncertainty of `full_wind_counts`."""

    @model_validator(mode="after")
    def _can_be_built(self) -> Self:
        n, pitch, radius, count = self.counts_per_revolution, self.groove_pitch_mm, self.drum_radius_mm, self.count_length_mm
        if radius is None and count is None:
            raise ValueError(message("error.drum_radius_mm_or"))
        if count is not None and n * count <= pitch:
            raise of_key("groove_pitch_mm", message("error.must_be_less_than", n=n * count))
        if radius is not None and count is not None:
            turn = math.hypot(2 * math.pi * radius, pitch)
            if abs(turn - n * count) > AGREEMENT * turn:
                raise ValueError(message("error.drum_radius_mm_gives", turn=turn, n=n * count))
        geometry = drum_geometry(self)
        if self.centre_distance_mm <= geometry.drum_radius_mm + self.fixed_pulley_radius_mm:
            radii_mm = geometry.drum_radius_mm + self.fixed_pulley_radius_mm
            why = message("error.mm_is_not_more", centre_distance_mm=self.centre_distance_mm, drum_radius_mm=radii_mm)
            raise of_key("centre_distance_mm", why)
        if self.full_wind_counts <= geometry.engaging_counts:
            counts = {"full_wind_counts": self.full_wind_counts, "engaging_counts": geometry.engaging_counts}
            raise of_key("full_wind_counts", message("error.is_not_more_than", **counts))
        return self


class DrumsFile(Strict):
    """Measured dimensions of drums, input of `lmeasure drum`."""

    schema_: Annotated[Literal["lmeasure.drum/1"], Field(alias="schema")]
    """Kind and version of the file."""
    drum: Annotated[tuple[DrumMeasurement, ...], Field(min_length=1)]
    """Drums, one table `[[drum]]` each."""

    @model_validator(mode="after")
    def _one_per_point(self) -> Self:
        names = [d.point for d in self.drum]
        for name in names:
            if names.count(name) > 1:
                raise of_key("drum", message("error.the_point_is_given", name=name, count=names.count(name)))
        return self


@dataclass(frozen=True)
class DrumGeometry:
    """The drum in the words of the thesis: lengths in mm, angles in rad, with the module's symbols; NaN where it cannot be built."""

    drum_radius_mm: float
    count_length_mm: float
    groove_angle: float
    engaging_angle: float
    engaging_counts: float
    engaging_travel_mm: float
    winding_travel_mm: float
    tangent_length_mm: float
    axial_offset_mm: float

    @property
    def stretch_mm(self) -> float:
        """|E_1 B_H|: cable from drum to fixed pulley at k = 0."""
        return math.hypot(self.tangent_length_mm, self.axial_offset_mm)


def drum_geometry(measured: DrumMeasurement) -> DrumGeometry:
    """The drum of thesis 5.5 from the measured values."""
    n, pitch = measured.counts_per_revolution, measured.groove_pitch_mm
    a, r2 = measured.centre_distance_mm, measured.fixed_pulley_radius_mm
    count = measured.count_length_mm
    if count is None:
        r1 = float(measured.drum_radius_mm or math.nan)
        count = math.hypot(2 * math.pi * r1, pitch) / n
    else:
        r1 = math.sqrt((n * count) ** 2 - pitch**2) / (2 * math.pi)
    gamma = math.atan(pitch / (2 * math.pi * r1))
    if abs(r1 - r2) >= a or r2 >= a:
        return DrumGeometry(r1, count, gamma, *(math.nan,) * 6)
    gamma2 = math.acos((r1 - r2) / a)
    gamma3 = gamma2 - math.asin(r2 / a)
    k0 = n * gamma3 / (2 * math.pi)
    t0 = r1 * gamma3 * math.tan(gamma)
    t1 = (measured.full_wind_counts - k0) * pitch / n
    axial_offset_mm = measured.pulley_plane_mm - measured.cable_end_mm - t0 - t1
    return DrumGeometry(r1, count, gamma, gamma3, k0, t0, t1, a * math.sin(gamma2), axial_offset_mm)


def drum_uncertainty(measured: DrumMeasurement) -> tuple[float, float]:
    """Standard uncertainties (tangent_length_mm, axial_offset_mm) from those of the measured values, independent (JCGM 100, 5.1.2)."""
    g, n = drum_geometry(measured), measured.counts_per_revolution
    if measured.count_length_mm is None:
        u_radius, radius_by_pitch = measured.u_drum_radius_mm, 0.0
    else:
        # R1 = sqrt((N c)^2 - t_m^2)/(2 pi)
        u_radius = n**2 * g.count_length_mm / (4 * math.pi**2 * g.drum_radius_mm) * measured.u_count_length_mm
        radius_by_pitch = -measured.groove_pitch_mm / (4 * math.pi**2 * g.drum_radius_mm)
    difference = (g.drum_radius_mm - measured.fixed_pulley_radius_mm) / g.tangent_length_mm
    by_centres = measured.centre_distance_mm / g.tangent_length_mm * measured.u_centre_distance_mm
    radius, pulley = difference * u_radius, difference * measured.u_fixed_pulley_radius_mm
    by_radii = radius, difference * radius_by_pitch * measured.u_groove_pitch_mm, pulley
    by_pitch = measured.full_wind_counts / n * measured.u_groove_pitch_mm, measured.groove_pitch_mm / n * measured.u_full_wind_counts
    return math.hypot(by_centres, *by_radii), math.hypot(measured.u_pulley_plane_mm, measured.u_cable_end_mm, *by_pitch)


def read_drums(path: Path) -> tuple[DrumMeasurement, ...]:
    """Read measured dimensions of drums.

    Parameters
    ----------
    path
        File of schema lmeasure.drum/1, with a table [[drum]] for each observation point.

    Returns
    -------
    tuple of DrumMeasurement
        One for each drum.

    Raises
    ------
    FileFormatError
        If the file is wrong. The message names file and key.

    Examples
    --------
    >>> lm.read_drums(Path("drums.toml"))  # doctest: +SKIP
    """
    return checked(files.read_toml(path), DrumsFile, str(path)).drum


def choose(measured: tuple[DrumMeasurement, ...], points: list[str], source: str) -> tuple[DrumMeasurement, ...]:
    """The drums of these observation points, all when none is named; FileFormatError names a point without a drum."""
    given = {m.point: m for m in measured}
    for name in points:
        if name not in given:
            raise FileFormatError(message("error.has_no_drum_of", where=source, name=name, given=", ".join(given)))
    return tuple(m for m in measured if not points or m.point in points)


def with_drums(rig: Rig, measured: tuple[DrumMeasurement, ...]) -> Rig:
    """Return a rig with measured drums.

    Parameters
    ----------
    rig
        The rig.
    measured
        Result of `read_drums`.

    Returns
    -------
    Rig
        Rig whose measured values are no longer assumed. A link to an earlier calibration is dropped.

    Raises
    ------
    RigError
        If a drum's observation point is not in the rig.

    Examples
    --------
    >>> lm.with_drums(rig, ()) == rig
    True
    """
    source = f"rig {rig.name!r}"
    return rig_from_dict(drums_into(rig.to_dict(), measured, source), source)


def drums_into(content: Mapping[str, Any], measured: tuple[DrumMeasurement, ...], source: str) -> dict[str, Any]:
    """A rig.toml's content with these drums, as `with_drums`, where it need have none yet; source is named in errors."""
    data = copy.deepcopy(dict(content))
    data.pop("calibration", None)
    stated, assumed = data.get("observation_point"), data.get("assumed", [])
    points: dict[Any, dict[str, Any]] = {p.get("name"): p for p in stated if isinstance(p, dict)} if isinstance(stated, list) else {}
    known: set[str] = set()
    for m in measured:
        if m.point not in points:
            others = ", ".join(map(str, points)) or None
            raise RigError(message("error.has_no_observation_point", where=source, point=m.point, points=others))
        g, (u_tangent, u_offset) = drum_geometry(m), drum_uncertainty(m)
        values: dict[str, float] = {
            "counts_per_revolution": m.counts_per_revolution,
            "count_length_mm": g.count_length_mm,
            "groove_pitch_mm": m.groove_pitch_mm,
            "tangent_length_mm": g.tangent_length_mm,
            "axial_offset_mm": g.axial_offset_mm,
        }
        known |= {f"{m.point}.{key}" for key in values}
        uncertain = {"u_tangent_length_mm": u_tangent, "u_axial_offset_mm": u_offset}
        there = points[m.point].get("drum", {})
        drum = {key: value for key, value in there.items() if key not in uncertain} if isinstance(there, dict) else {}
        points[m.point]["drum"] = drum | values | {key: u for key, u in uncertain.items() if u > 0}
    if isinstance(assumed, list):
        left = [name for name in assumed if name not in known]
        data |= {"assumed": left} if left or "assumed" in data else {}
    return data


def drum_summary(measured: Sequence[DrumMeasurement]) -> list[str]:
    """Return lines, one for all drums that are alike: the values for the rig file, and angles for a check."""
    points: dict[str, list[str]] = {}
    for m in measured:
        points.setdefault(_figures(m), []).append(m.point)
    return [message("rig.drum", points=tuple(names), figures=figures) for figures, names in points.items()]


def _figures(measured: DrumMeasurement) -> str:
    g, (u_tangent, u_offset) = drum_geometry(measured), drum_uncertainty(measured)
    tangent, offset = (message("rig.u", u=u) if u > 0 else message("rig.u_not_stated") for u in (u_tangent, u_offset))
    return message(
        "rig.drum_figures", tangent=g.tangent_length_mm, u_tangent=tangent, offset=g.axial_offset_mm, u_offset=offset,
        count=g.count_length_mm, angle=math.degrees(g.groove_angle), stretch=g.stretch_mm,
    )  # fmt: skip
