"""The edge refined: a coarse grid gives the volume."""

import numpy as np
import pytest
from zone_rigs import cell

from lmeasure.accuracy import axis, scan_zone, tilts
from lmeasure.accuracy.zone import refined_volume


def ball(points: np.ndarray) -> np.ndarray:
    return np.asarray((points**2).sum(axis=-1) <= 400.0**2)


def test_ball_on_a_coarse_grid_has_its_volume_to_a_percent() -> None:
    nodes = np.linspace(-550, 550, 9)
    inside = ball(np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), axis=-1))
    exact = 4 / 3 * np.pi * 400.0**3
    plain = inside.sum() * (nodes[1] - nodes[0]) ** 3
    refined = refined_volume(inside, [nodes] * 3, ball, 1e-3)
    assert abs(plain / exact - 1) > 0.02
    assert refined["refined_volume_mm3"] == pytest.approx(exact, rel=2e-3)
    assert refined["refined_volume_change_mm3"] <= 1e-3 * exact


def test_coarse_zone_has_the_volume_of_a_fine_one() -> None:
    rig = cell()
    coarse_nodes, fine_nodes = axis(-400, 400, 100), axis(-400, 400, 12.5)
    limit = float(
        np.median(scan_zone(rig, None, x=coarse_nodes, y=coarse_nodes, z=coarse_nodes, rotations=tilts(0, 1))["worst_pressure_angle_deg"])
    )
    coarse = scan_zone(rig, None, x=coarse_nodes, y=coarse_nodes, z=coarse_nodes, rotations=tilts(0, 1), limit_deg=limit, refine=2e-3)
    fine = scan_zone(rig, None, x=fine_nodes, y=fine_nodes, z=fine_nodes, rotations=tilts(0, 1), limit_deg=limit)["in_zone"].values.astype(
        float
    )
    # the trapezoid rule over the box, as nodes on its faces own half a cell
    weight = np.ones(len(fine_nodes))
    weight[[0, -1]] = 0.5
    volume = float(np.einsum("ijk,i,j,k", fine, weight, weight, weight)) * 12.5**3
    assert 0.2 < volume / 800.0**3 < 0.8
    assert coarse.attrs["refined_volume_mm3"] == pytest.approx(volume, rel=0.01)
