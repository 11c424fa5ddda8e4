"""Zones: against definitions worked out apart, against the thesis, and as files."""

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation
from zeroed import exactly
from zone_oracle import length_rows, pressure_angles, sphere_radius
from zone_rigs import cell, published

from lmeasure.accuracy import REASONS, Limits, axis, limit_from_accuracy, read_zone, scan_zone, summary, tilts, write_zone
from lmeasure.accuracy.zone import covers, drum_variance
from lmeasure.core import AccuracyError, FileFormatError, RigError, rotation_from_angles
from lmeasure.kernels import length_gradients
from lmeasure.rig import CalibrationRecord, RecordedParameter, Rig, rig_from_dict
from lmeasure.sensors import cable_covariance, counts_from_poses, length_variance

COUNT_MM = 0.0125


def plain(rig: Rig) -> list[dict[str, np.ndarray]]:
    return [{"B": r[0:3], "u": r[3:6], "R": r[6], "P": r[7:10]} for r in rig.cable_rows()]


@pytest.mark.parametrize("rig", [published(), cell(0), cell(1)], ids=["published", "cell-0", "cell-1"])
def test_angles_and_radius_are_those_of_the_definitions(rig: Rig) -> None:
    random = np.random.default_rng(7)
    cables = plain(rig)
    for _ in range(4):
        at, turn = random.uniform(-200, 200, 3), Rotation.from_rotvec(random.uniform(-0.3, 0.3, 3))
        zone = scan_zone(rig, None, x=at[:1], y=at[1:2], z=at[2:], rotations=Rotation.concatenate([turn]))
        angles = pressure_angles(at, turn.as_matrix(), cables)
        assert zone["worst_pressure_angle_deg"].item() == pytest.approx(np.degrees(angles.max()), abs=1e-4)
        inverse = np.linalg.inv(length_rows(at, turn.as_matrix(), cables))
        # each count is rounded, and counted from somewhere within one
        covariance = inverse[3:] @ inverse[3:].T * 2 * COUNT_MM**2 / 12
        assert zone["u95_position_mm"].item() == pytest.approx(sphere_radius(covariance, random), rel=6e-3)
        sure = scan_zone(exactly(rig), None, x=at[:1], y=at[1:2], z=at[2:], rotations=Rotation.concatenate([turn]))
        assert sure["u95_position_mm"].item() == pytest.approx(zone["u95_position_mm"].item() / np.sqrt(2.0), rel=1e-9)
    assert "counts of +-1/2, the sub-count offset at zeroing (the same size)" in zone.attrs["u95_covers"]
    assert "phase" not in sure.attrs["u95_covers"]


def test_worst_is_over_all_orientations() -> None:
    rig, nodes = cell(), axis(-100, 100, 100)
    all_of_them = tilts(0.3, 3)
    zone = scan_zone(rig, None, x=nodes, y=nodes, z=nodes, rotations=all_of_them)
    alone = [scan_zone(rig, None, x=nodes, y=nodes, z=nodes, rotations=all_of_them[i : i + 1]) for i in range(27)]
    for name, worst in (("worst_pressure_angle_deg", np.max), ("u95_position_mm", np.max), ("shortest_cable_mm", np.min)):
        # the order in which the cables are taken may differ, and with it the rounding
        np.testing.assert_allclose(zone[name].values, worst([z[name].values for z in alone], axis=0), rtol=1e-9)


def test_thesis_example_at_the_origin() -> None:
    """Thesis 5.7 recomputed on its refined base points: angles 86.4 78.6 79.2 87.1 86.6 86.3, lengths 2158 to 1770 mm."""
    zero = rotation_from_angles("puma-oat", [[0.0, 0.0, 0.0]])
    zone = scan_zone(published(), None, x=np.zeros(1), y=np.zeros(1), z=np.zeros(1), rotations=zero)
    assert zone["worst_pressure_angle_deg"].item() == pytest.approx(87.1, abs=0.05)
    assert zone["shortest_cable_mm"].item() == pytest.approx(1770, abs=0.5)
    assert zone["longest_cable_mm"].item() == pytest.approx(2158, abs=0.5)
    np.testing.assert_allclose(
        np.degrees(pressure_angles(np.zeros(3), zero[0].as_matrix(), plain(published()))), [86.4, 78.6, 79.2, 87.1, 86.6, 86.3], atol=0.05
    )


def test_no_pose_of_the_published_rig_lies_within_60_degrees() -> None:
    zero = rotation_from_angles("puma-oat", [[0.0, 0.0, 0.0]])
    zone = scan_zone(
        published(), None, x=axis(-750, 750, 150), y=axis(-750, 750, 150), z=axis(-300, 700, 100), rotations=zero,
        length_limits=(700.0, 2300.0),
    )  # fmt: skip
    reachable = (zone["rejected_because"].values & (1 << REASONS.index("cable_too_long") | 1 << REASONS.index("cable_too_short"))) == 0
    assert reachable.sum() == 846
    assert zone["worst_pressure_angle_deg"].values[reachable].min() == pytest.approx(80.2, abs=0.05)
    assert zone.attrs["nodes_in_zone"] == 0
    assert zone.attrs["zone_volume_mm3"] == 0


def test_limit_of_the_thesis() -> None:
    assert limit_from_accuracy(0.025, 0.05) == pytest.approx(60.0, abs=1e-12)
    assert limit_from_accuracy(0.0125, 0.05) == pytest.approx(75.522, abs=5e-4)
    with pytest.raises(AccuracyError, match="is impossible with"):
        limit_from_accuracy(0.05, 0.025)


def record(rig: Rig, random: np.random.Generator) -> CalibrationRecord:
    names = [f"{p.name}.{key}" for p in rig.observation_point for key in ("x_mm", "y_mm", "z_mm", "guide_alpha_deg", "guide_beta_deg")]
    draws = random.standard_normal((len(names), 2 * len(names))) * 0.02
    covariance = draws @ draws.T / len(names)
    return CalibrationRecord(
        rig=rig.name, parameters=tuple(RecordedParameter(name=n, value=0.0, u=0.1, prior_u=1.0) for n in names),
        covariance=tuple(tuple(float(v) for v in row) for row in 0.5 * (covariance + covariance.T)), residuals=(), equations=100,
        unknowns=len(names), rank=len(names),
    )  # fmt: skip


def test_linked_calibration_enters_with_the_zero_pose() -> None:
    rig, random = cell(), np.random.default_rng(3)
    calibration = record(rig, random)
    start = np.array([10.0, -20.0, 30.0, 0.0, 0.0, 0.0, 1.0])
    at = np.array([150.0, 120.0, -80.0])
    zone = scan_zone(rig, calibration, x=at[:1], y=at[1:2], z=at[2:], rotations=Rotation.identity(1), start=start)
    pose = np.concatenate([at, [0, 0, 0, 1]])[None, :]
    counts = counts_from_poses(rig, pose, start)
    rows, scales, none = rig.cable_rows(), rig.scales(), np.zeros((1, 6))
    since = (length_gradients(rows, pose, counts, scales) - length_gradients(rows, start[None], none, scales))[0]
    by_parameter = scipy.linalg.block_diag(*since)
    of_lengths = np.diag(length_variance(rig)) + by_parameter @ cable_covariance(rig, calibration) @ by_parameter.T
    inverse = np.linalg.inv(length_rows(at, np.eye(3), plain(rig)))[3:]
    covariance = inverse @ of_lengths @ inverse.T
    assert zone["u95_position_mm"].item() == pytest.approx(sphere_radius(covariance, random), rel=6e-3)
    assert "linked calibration" in zone.attrs["u95_covers"]
    # at the start pose itself only the counts are unsure
    here = scan_zone(rig, calibration, x=start[:1], y=start[1:2], z=start[2:3], rotations=Rotation.identity(1), start=start)
    alone = scan_zone(rig, None, x=start[:1], y=start[1:2], z=start[2:3], rotations=Rotation.identity(1))
    assert here["u95_position_mm"].item() == pytest.approx(alone["u95_position_mm"].item(), rel=1e-12)


def test_what_cannot_run_or_is_singular_is_ninety_degrees_and_never_in_the_zone() -> None:
    rig = cell()
    base = np.array(rig.observation_point[0].position_mm)
    arm = np.array(rig.tool["P1"])
    # P1 inside the pulley of B1
    normal = np.cross(rig.cable_rows()[0][3:6], [0, 0, 1.0])
    at = base - arm + rig.observation_point[0].pulley_radius_mm * normal / np.linalg.norm(normal)
    zone = scan_zone(rig, None, x=at[:1], y=at[1:2], z=at[2:], rotations=Rotation.identity(1), limit_deg=90.0)
    assert zone["worst_pressure_angle_deg"].item() == 90.0
    assert np.isinf(zone["u95_position_mm"].item())
    assert zone["in_zone"].item() == 0
    assert zone["rejected_because"].item() & 1


def test_volume_is_nodes_times_their_cell(tmp_path: Path) -> None:
    zone = scan_zone(
        cell(), None, x=axis(-300, 300, 100), y=axis(-300, 300, 150), z=axis(0, 300, 50), rotations=tilts(0.1, 2), limit_deg=80.0
    )
    assert zone.attrs["nodes_in_zone"] > 0
    assert zone.attrs["zone_volume_mm3"] == pytest.approx(int(zone["in_zone"].sum()) * 100 * 150 * 50)
    write_zone(tmp_path / "zone.nc", zone)
    back = read_zone(tmp_path / "zone.nc")
    for name in zone.data_vars:
        np.testing.assert_array_equal(back[name].values, zone[name].values)
    assert summary(back) == summary(zone)
    (tmp_path / "other.nc").write_bytes(b"not netCDF")
    with pytest.raises(FileFormatError, match=r"other\.nc"):
        read_zone(tmp_path / "other.nc")


def test_limits_asked_for_are_kept_and_named() -> None:
    nodes = axis(-300, 300, 100)
    free = scan_zone(cell(), None, x=nodes, y=nodes, z=nodes, rotations=tilts(0.2, 3))
    u95, longest = float(free["u95_position_mm"].median()), float(free["longest_cable_mm"].median())
    held = scan_zone(cell(), None, x=nodes, y=nodes, z=nodes, rotations=tilts(0.2, 3), limits=Limits(80.0, (0.0, longest), u95))
    expected = (free["worst_pressure_angle_deg"] <= 80) & (free["longest_cable_mm"] <= longest) & (free["u95_position_mm"] <= u95)
    np.testing.assert_array_equal(held["in_zone"].values, expected.values)
    np.testing.assert_array_equal(held["in_zone"].values == 0, held["rejected_because"].values != 0)
    assert held["rejected_because"].attrs["flag_meanings"].split() == list(REASONS)


def test_rig_that_cannot_tell_a_pose_is_refused() -> None:
    rig = published()
    short = rig.model_copy(update={"cable": rig.cable[:5]})
    with pytest.raises(RigError, match="5 cables"):
        scan_zone(short, None, x=np.zeros(1), y=np.zeros(1), z=np.zeros(1), rotations=Rotation.identity(1))


def test_a_place_alone_has_no_step_unless_it_is_told() -> None:
    zone = scan_zone(cell(), None, x=axis(0, 0, 1), y=axis(0, 50, 50), z=axis(0, 0, 1), rotations=tilts(0, 1))
    assert list(zone.attrs["node_spacing_mm"]) == [0.0, 50.0, 0.0]
    assert zone.attrs["limit_deg"] == 60.0
    determined = scan_zone(
        cell(), None, x=axis(0, 0, 1), y=axis(0, 50, 50), z=axis(0, 0, 1), rotations=tilts(0, 1), spacing_mm=(10.0, 20.0, 30.0)
    )
    assert list(determined.attrs["node_spacing_mm"]) == [10.0, 50.0, 30.0]


def test_the_assembly_is_the_sign_of_the_rows() -> None:
    """Two cables exchanged are the other assembly; where the orientations have both, none."""
    rig, nodes = cell(), axis(-50, 50, 50)
    data = rig.to_dict()
    data["cable"][0], data["cable"][1] = data["cable"][1], data["cable"][0]
    signs = set()
    for one in (rig, rig_from_dict(data)):
        found = scan_zone(one, None, x=nodes, y=nodes, z=nodes, rotations=Rotation.identity(1))["assembly"].values
        places = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), axis=-1)
        sides = np.array([[[np.sign(np.linalg.det(length_rows(at, np.eye(3), plain(one)))) for at in b] for b in a] for a in places])
        np.testing.assert_array_equal(found, sides)
        signs.add(sides[0, 0, 0])
    assert signs == {-1.0, 1.0}
    far = Rotation.from_rotvec(np.outer(np.linspace(0.0, 3.0, 13), [0.0, 0.0, 1.0]))
    signs = {np.sign(np.linalg.det(length_rows(np.zeros(3), turn.as_matrix(), plain(rig)))) for turn in far}
    assert signs == {-1.0, 1.0}
    assert scan_zone(rig, None, x=axis(0, 0, 1), y=axis(0, 0, 1), z=axis(0, 0, 1), rotations=far)["assembly"].item() == 0


def test_play_is_once_where_it_was_zeroed_and_once_at_the_pose() -> None:
    data = cell().to_dict()
    for point in data["observation_point"]:
        point["drum"]["u_backlash_counts"] = 3.0
    start = np.array([0, 0, 0, 0, 0, 0, 1.0])
    found = drum_variance(rig_from_dict(data), None, np.array([[100.0, 50.0, -20.0]]), Rotation.identity(1), start=start)
    np.testing.assert_allclose(found, 2.0 * (3.0 * COUNT_MM) ** 2, rtol=1e-12)
    np.testing.assert_array_equal(drum_variance(cell(), None, np.zeros((1, 3)), Rotation.identity(1), start=start), np.zeros(6))


def test_run_out_counts_by_the_turns_of_its_drum_on_the_mean_over_places() -> None:
    """Of two components of u, each less what it was where the counter was zeroed: 2 u^2 (1 - cos theta)."""
    data = cell().to_dict()
    for number, point in enumerate(data["observation_point"]):
        point["drum"]["u_run_out_mm"] = 0.01 * (number + 1)
    rig, start = rig_from_dict(data), np.array([0, 0, 0, 0, 0, 0, 1.0])
    places = np.array([[100.0, 50.0, -20.0], [-30.0, 80.0, 60.0], [0.0, -45.0, 10.0]])
    counts = counts_from_poses(cell(), np.array([[*p, 0.0, 0.0, 0.0, 1.0] for p in places]), start)
    theta = 2.0 * np.pi * counts / rig.cable_rows()[:, 16]
    u = np.array([rig.point(c.from_point).drum.u_run_out_mm for c in rig.cable], dtype=np.float64)
    expected = 2.0 * u**2 * (1.0 - np.cos(theta)).mean(axis=0)
    found = drum_variance(rig, None, places, Rotation.identity(1), start=start)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    said = covers(rig, None)
    assert "the uncertainty of run-out of drums" in said
    assert said.endswith("all for changes of length since zeroing at the start pose. The rig has no linked calibration")
