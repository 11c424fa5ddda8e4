"""How well any channels tell the pose over a cell: what `zone` works out for cables in compiled code, plainly and for every kind."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.accuracy.radius import exact_radius_95
from lmeasure.accuracy.zone_dataset import ABOUT, DIMS, about
from lmeasure.core import FloatArray, se3
from reference.channel import Channels, variances
from reference.solver import pressure_angles, shared_errors, twists

if TYPE_CHECKING:
    import xarray as xr


class Figures(NamedTuple):
    """covariance (n, 6, 6) of (rotation [rad]; tool origin [mm]), base axes; u95_position_mm (n,), the radius at the tool origin that holds
    95 %; worst_pressure_angle_deg (n,). Where the pose is not told: NaN, infinite, 90."""

    covariance: FloatArray
    u95_position_mm: FloatArray
    worst_pressure_angle_deg: FloatArray


def figures(channels: Channels, poses: FloatArray, names: tuple[str, ...] = (), root: FloatArray | None = None) -> Figures:
    """Of (n, 7) poses: by the variances of single readings, and by errors of the parameters names (q,) of the channels, whose covariance
    is root root^T, root (q, r), in their units."""
    G = twists(channels, poses)
    every = G * np.sqrt(variances(channels))
    if root is not None:
        every = np.concatenate([every, shared_errors(channels, poses, G, names, root=root)], axis=2)
    covariance = every @ np.swapaxes(every, 1, 2)
    reported = np.isfinite(covariance).all(axis=(1, 2))
    u95, angle = np.full(len(poses), np.inf), np.full(len(poses), 90.0)
    u95[reported] = [exact_radius_95(values) for values in np.linalg.eigvalsh(covariance[reported, 3:, 3:])]
    # geometry, whatever the readings are known to
    alike = twists(channels, poses[reported], weighted=False)
    angle[reported] = np.degrees(pressure_angles(channels, poses[reported], alike).max(axis=1))
    return Figures(covariance, u95, angle)


def map_channels(
    channels: Channels,
    *,
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
    rotations: Rotation,
    names: tuple[str, ...] = (),
    root: FloatArray | None = None,
) -> "xr.Dataset":
    """The worst of `figures` over the orientations, base_from_tool, at each node x, y, z [mm] of the tool origin: a dataset with the names
    of `scan_zone`."""
    axes = [np.atleast_1d(np.asarray(a, dtype=np.float64)) for a in (x, y, z)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    found = [figures(channels, se3.pose(places, turn), names, root) for turn in rotations]
    worst = {name: np.max([getattr(f, name) for f in found], axis=0) for name in ("worst_pressure_angle_deg", "u95_position_mm")}
    shape = [len(a) for a in axes]
    import xarray as xr

    return xr.Dataset(
        {name: (DIMS, values.reshape(shape), about(*ABOUT[name])) for name, values in worst.items()},
        coords={name: (name, a, about(f"{name} of the tool origin, base frame", "mm")) for name, a in zip(DIMS, axes, strict=True)},
    )
