"""The skin of a zone: closed, outward, and around what the zone holds."""

from collections import Counter

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

from lmeasure.accuracy import zone_surface
from lmeasure.core import FloatArray

IntArray = NDArray[np.int64]

AXIS = np.linspace(-400.0, 400.0, 33)


def zone(angle: FloatArray, inside: NDArray[np.bool_] | None = None) -> xr.Dataset:
    kept = angle <= 60.0 if inside is None else inside
    data = {"worst_pressure_angle_deg": (("x", "y", "z"), angle), "in_zone": (("x", "y", "z"), kept.astype(np.int8))}
    return xr.Dataset(data, coords=dict.fromkeys("xyz", AXIS) | {n: (n, AXIS) for n in "xyz"}, attrs={"limit_deg": 60.0})


def distance() -> FloatArray:
    return np.asarray(np.linalg.norm(np.stack(np.meshgrid(AXIS, AXIS, AXIS, indexing="ij"), axis=-1), axis=-1))


def volume(vertices: FloatArray, triangles: IntArray) -> float:
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def closed(triangles: IntArray) -> bool:
    edges = Counter((int(t[i]), int(t[(i + 1) % 3])) for t in triangles for i in range(3))
    return all(edges[b, a] == n for (a, b), n in edges.items())


def test_a_ball_has_the_skin_of_a_ball() -> None:
    # the angle passes 60 degrees at 300 mm
    vertices, triangles = zone_surface(zone(distance() * 0.2))
    assert np.linalg.norm(vertices, axis=1) == pytest.approx(300.0, abs=2.0)
    assert closed(triangles)
    assert volume(vertices, triangles) == pytest.approx(4 / 3 * np.pi * 300.0**3, rel=0.01)


def test_a_zone_that_fills_the_box_ends_at_its_faces() -> None:
    vertices, triangles = zone_surface(zone(np.full((33,) * 3, 30.0)))
    assert closed(triangles)
    assert np.abs(vertices).max() == 400.0
    assert volume(vertices, triangles) == pytest.approx(800.0**3, rel=1e-9)


def test_another_limit_puts_the_skin_half_way_between_the_nodes() -> None:
    inside = np.zeros((33,) * 3, bool)
    inside[10:20, 10:20, 10:20] = True
    vertices, triangles = zone_surface(zone(np.full((33,) * 3, 30.0), inside))
    assert closed(triangles)
    assert vertices.max() == pytest.approx(AXIS[19] + 12.5)
    assert volume(vertices, triangles) == pytest.approx(250.0**3, rel=0.03)


def test_an_empty_zone_has_no_skin() -> None:
    vertices, triangles = zone_surface(zone(np.full((33,) * 3, 80.0)))
    assert len(vertices) == len(triangles) == 0
