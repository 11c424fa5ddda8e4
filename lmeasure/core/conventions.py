"""Controller angles and rotations: one tested pair of functions for all conventions.

A rotation here is `base_from_tool`: it takes tool coordinates to base coordinates. Angles of a singular orientation are not unique
(puma-oat at A = -90 or 90 degrees, which is where the identity lies): compare rotations, never angles.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from lmeasure.core.arrays import FloatArray
from lmeasure.core.errors import FileFormatError

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class AngleConvention:
    """A controller's way to write an orientation: its name, its columns, the intrinsic axes, and angles added before turning."""

    name: str
    columns: tuple[str, str, str]
    axes: str
    offset_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)


CONVENTIONS = {
    c.name: c
    for c in (
        # Thesis Rashoyan 2021, 5.5: M = Rz(O - 90) Ry(A + 90) Rz(T); the printed M11 and M21 have misprints
        AngleConvention("puma-oat", ("o_deg", "a_deg", "t_deg"), "ZYZ", (-90.0, 90.0, 0.0)),
        AngleConvention("kuka-abc", ("a_deg", "b_deg", "c_deg"), "ZYX"),
        # W, P, R turn about the fixed X, Y, Z: Rz(R) Ry(P) Rx(W)
        AngleConvention("fanuc-wpr", ("w_deg", "p_deg", "r_deg"), "xyz"),
        AngleConvention("staubli-xyz", ("rx_deg", "ry_deg", "rz_deg"), "XYZ"),
        AngleConvention("zyz", ("phi_deg", "theta_deg", "psi_deg"), "ZYZ"),
        AngleConvention("ur-rotation-vector", ("rx_rad", "ry_rad", "rz_rad"), "rotvec"),
    )
}
OF_DOCUMENTS = {
    c.name: c
    for c in (
        # Thesis Rashoyan 2021, 4.1, and Skvortsov 2017, 3: alpha, beta, gamma about the fixed X, Y, Z: Rz(gamma) Ry(beta) Rx(alpha)
        AngleConvention("fixed-xyz", ("alpha_deg", "beta_deg", "gamma_deg"), "xyz"),
        # source 004: Rz(psi) Rx(theta) Rz(phi)
        AngleConvention("zxz", ("psi_deg", "theta_deg", "phi_deg"), "ZXZ"),
    )
}
"""Conventions of the source documents, which no controller has: names that are known too, but not offered for rigs and programs."""
DEFAULT = "puma-oat"
RESERVED_COLUMNS = ("time_s", "sync", "u_time_s", "temperature_c", "pose", "pass")  # Columns of counts files that are no counter
MAX_LENGTH_MM = 1e6
"""A kilometre: beyond it a length is a slip of units."""
LARGEST_ANGLE = 1e6
"""Largest angle in degrees or radians: thousands of turns; a larger one is a slip."""
QUATERNION_COLUMNS = ("qx", "qy", "qz", "qw")


def convention(name: str) -> AngleConvention:
    """The convention of that name; FileFormatError names the known ones."""
    every = CONVENTIONS | OF_DOCUMENTS
    if name not in every:
        raise FileFormatError(f"angles = {name!r} is not a known convention. Use one of {', '.join(every)}")
    return every[name]


def check_angles(values: ArrayLike, what: str) -> None:
    """Raise FileFormatError, naming `what`, for an angle beyond `LARGEST_ANGLE`: a double of 1e20 degrees has lost even the turn."""
    numbers = np.atleast_1d(np.asarray(values, dtype=np.float64))
    bad = np.abs(numbers) > LARGEST_ANGLE
    if bad.any():
        raise FileFormatError(f"{what}: an angle of {numbers[bad][0]:g} is too large. The limit is {LARGEST_ANGLE:g}")


def rotation_from_angles(name: str, angles: ArrayLike) -> "Rotation":
    """Convert the angles of a controller's convention to rotations base_from_tool.

    Parameters
    ----------
    name
        Convention, such as "puma-oat" or "kuka-abc".
    angles
        (..., 3) angles in the convention's columns and units: degrees, or radians for a rotation vector.

    Returns
    -------
    scipy.spatial.transform.Rotation
        Rotations of the same shape.

    Raises
    ------
    FileFormatError
        If the convention does not exist or an angle is beyond `LARGEST_ANGLE`.

    Examples
    --------
    >>> lm.rotation_from_angles("kuka-abc", [90.0, 0.0, 0.0]).apply([1.0, 0.0, 0.0]).round(9).tolist()
    [0.0, 1.0, 0.0]
    """
    from scipy.spatial.transform import Rotation

    c = convention(name)
    values = np.asarray(angles, dtype=np.float64)
    check_angles(values, name)
    if c.axes == "rotvec":
        return Rotation.from_rotvec(values)
    return Rotation.from_euler(c.axes, values + np.asarray(c.offset_deg), degrees=True)


def angles_from_rotation(name: str, rotation: "Rotation") -> FloatArray:
    """Convert rotations base_from_tool to the angles of a controller's convention.

    Parameters
    ----------
    name
        Convention, such as "puma-oat" or "kuka-abc".
    rotation
        n rotations, or one.

    Returns
    -------
    ndarray
        (n, 3) or (3,) angles in the convention's units, each within (-180, 180] degrees. At a singular orientation the third angle is 0.

    Raises
    ------
    FileFormatError
        If the convention does not exist.

    Examples
    --------
    >>> lm.angles_from_rotation("kuka-abc", lm.rotation_from_angles("kuka-abc", [30.0, 0.0, 0.0])).round(9).tolist()
    [30.0, 0.0, 0.0]
    """
    c = convention(name)
    if c.axes == "rotvec":
        return np.asarray(rotation.as_rotvec(), dtype=np.float64)
    angles = np.asarray(rotation.as_euler(c.axes, degrees=True, suppress_warnings=True), dtype=np.float64)
    angles = angles - np.asarray(c.offset_deg)
    return np.asarray(180.0 - np.mod(180.0 - angles, 360.0), dtype=np.float64)


def rounded_angles(name: str, angles: ArrayLike) -> FloatArray:
    """Angles (..., 3) as they are typed into a controller: to 0.01 degrees, of a rotation vector to 0.0001 rad."""
    return np.round(np.asarray(angles, dtype=np.float64), 4 if convention(name).axes == "rotvec" else 2) + 0.0


def from_singular_deg(name: str, rotation: "Rotation") -> FloatArray:
    """Return the (...,) distances [degrees, 0 to 90] of rotations from an orientation whose angles are not unique. There the first and the
    last axis of three turns lie on one line: the distance is the angle between them. A rotation vector is not unique at half a turn; its
    distance is the rest of the half turn, at most 90."""
    c = convention(name)
    if c.axes == "rotvec":
        return np.minimum(180.0 - np.degrees(rotation.magnitude()), 90.0)
    # turns about fixed axes are turns about carried axes in the other order
    axes = ["XYZ".index(axis) for axis in (c.axes if c.axes.isupper() else c.axes[::-1]).upper()]
    cosine = rotation.as_matrix()[..., axes[0], axes[2]]
    return np.asarray(np.degrees(np.arccos(np.minimum(np.abs(cosine), 1.0))))


TEMPERATURE_RANGE_C = (-100.0, 200.0)


def check_temperature(values: ArrayLike, what: str) -> None:
    """Raise FileFormatError, naming `what`, for temperatures [deg C] outside `TEMPERATURE_RANGE_C` or not finite."""
    numbers = np.atleast_1d(np.asarray(values, dtype=np.float64))
    low, high = TEMPERATURE_RANGE_C
    bad = ~((numbers >= low) & (numbers <= high))
    if bad.any():
        raise FileFormatError(f"{what} = {numbers[bad][0]:g} is no temperature. State it in deg C, between {low:g} and {high:g}")
