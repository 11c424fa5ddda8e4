"""What decides whether a robot misses its poses or is in another frame."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic_paths import LINE, program_of, runs
from synthetic_trajectories import UNIT, dwells, trajectory_of

from lmeasure.core import CertificationError, FileFormatError, se3
from lmeasure.iso9283 import CertificationSettings
from lmeasure.iso9283.attainment import Attainment, _besides_a_frame, attained, places_in
from lmeasure.recording import Program
from lmeasure.trajectory.time.stamps import sound


@pytest.mark.parametrize("grown", [0.0, 0.01])
def test_what_a_frame_does_not_explain_is_how_far_poses_are_off(grown: float) -> None:
    """Corners of a tetrahedron in another frame, and larger by a part, which no frame makes good."""
    corners = 100.0 * np.array([(1.0, 1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0)])
    moved = np.array([5.0, -7.0, 300.0]) + (1.0 + grown) * Rotation.from_rotvec([0.3, -0.2, 0.9]).apply(corners)
    orientation = Rotation.identity(3)
    poses: list[Any] = [
        SimpleNamespace(commanded=np.r_[place, 0, 0, 0, 1], poses=se3.pose(np.tile(at, (3, 1)), orientation))
        for place, at in zip(corners, moved, strict=True)
    ]
    assert _besides_a_frame(poses) == pytest.approx(grown * 100.0 * np.sqrt(3.0), abs=1e-9)
    assert _besides_a_frame(poses[:2]) == np.inf


ORDINARY = {"A": (0.0, 0.0, 0.0), "B": (100.0, 0.0, 0.0), "C": (0.0, 100.0, 0.0), "D": (0.0, 0.0, 100.0)}
MISSED = {"B": (0.0, 6.0, 6.0), "C": (6.0, 0.0, -6.0), "D": (-6.0, -6.0, 0.0)}
"""Each elsewhere, which no frame explains."""


def attain_at(
    places: dict[str, tuple[float, float, float]], commanded: dict[str, tuple[float, float, float]], cycles: int = 3, **chosen: Any
) -> Attainment:
    """What is attained by a robot that goes through commanded positions and rests at other ones."""
    time_s, position, windows = dwells(np.array(list(places.values()) * cycles))
    poses = [{"name": name, "position_mm": at, "quaternion_xyzw": UNIT} for name, at in commanded.items()]
    for i, name in enumerate(places):
        next(p for p in poses if p["name"] == name)["windows_s"] = windows[i :: len(places)]
    program = Program.model_validate({"schema": "lmeasure.program/1", "pose": poses})
    return attained(trajectory_of(time_s, position), program, CertificationSettings(**chosen), sound(time_s), rig_angles=None)


@pytest.mark.parametrize(("near", "reported"), [(14.5, False), (15.0, False), (15.5, True), (21.0, True)])
def test_a_robot_that_misses_poses_is_not_taken_to_miss_by_more_than_a_twentieth_of_its_program(near: float, reported: bool) -> None:
    """Of poses within three times that of each other nobody can tell at which one it is, whatever the size of its misses and wherever in
    the cell the program is."""
    away = (1000.0, 0.0, -400.0)
    ideal = ORDINARY | {"near A": (-near, 0.0, 0.0), "B": (100.0 - near, 0.0, 0.0)}
    off = {"A": (3.0 - near, 1.0, 0.0)} | MISSED
    commanded = {name: tuple(np.add(at, away).tolist()) for name, at in ideal.items()}
    places = {name: tuple(np.add(commanded[name], by).tolist()) for name, by in off.items()}
    if not reported:
        assert set(attain_at(places, commanded).poses) == set("ABCD")
        return
    with pytest.raises(CertificationError, match=r"pose A, cycle 1: at 0.745 s the tool is .* mm from A and 3.162 mm from near A"):
        attain_at(places, commanded)


@pytest.mark.parametrize(("at", "reported"), [(149.0, False), (151.0, True)])
def test_a_robot_is_at_another_pose_where_that_is_three_times_as_near(at: float, reported: bool) -> None:
    """Also one that comes to all others without any miss."""
    commanded = {"A": (0.0, 0.0, 0.0), "B": (200.0, 0.0, 0.0)}
    places = {"A": (at, 0.0, 0.0), "B": (200.0, 0.0, 0.0)}
    if not reported:
        assert set(attain_at(places, commanded).poses) == set("AB")
        return
    with pytest.raises(CertificationError, match=r"pose A, cycle 1: at .* s the tool is 151 mm from A and 49 mm from B: "):
        attain_at(places, commanded)


@pytest.mark.parametrize(("apart", "reported"), [(0.59, False), (0.61, True)])
def test_a_pose_is_told_from_another_one_where_they_are_apart_by_three_times_what_rest_allows(apart: float, reported: bool) -> None:
    commanded = {"A": (0.0, 0.0, 0.0), "B": (apart, 0.0, 0.0), "C": (300.0, 0.0, 0.0)}
    places = {"A": commanded["B"], "C": commanded["C"]}
    if not reported:
        assert set(attain_at(places, commanded, still_mm=0.2).poses) == set("AC")
        return
    with pytest.raises(CertificationError, match="pose A, cycle 1"):
        attain_at(places, commanded, still_mm=0.2)


@pytest.mark.parametrize(("u_time_s", "planes"), [(0.0, 60), (0.002, 60), (0.008, 50), (0.01, 40), (1.0, 10)])
def test_planes_are_so_few_that_the_robot_needs_ten_uncertainties_of_an_instant_from_each_to_the_next(u_time_s: float, planes: int) -> None:
    """In the shorter one of two cycles, of 4 s, and whenever it was; never fewer than ten."""
    way = np.concatenate([np.linspace(-10.0, 510.0, count)[:-1] for count in (601, 401)])
    time_s = 1000.0 + np.arange(len(way)) / 100.0
    trajectory = trajectory_of(time_s, way[:, None] * np.array([0.6, 0.8, 0.0]))
    windows = [(1000.0, 1005.99), (1006.0, 1010.0)]
    stamps = replace(sound(time_s), u_time_s=u_time_s)
    crossed = attained(trajectory, program_of(LINE, windows), CertificationSettings(planes=60), stamps, rig_angles=None).paths["line"]
    assert crossed.time_s.shape == (planes, 2)


def test_of_a_path_that_is_run_once_the_convention_is_that_of_its_angles() -> None:
    """And none where its orientation is not measured."""
    way = np.arange(-10.0, 510.0, 2.0)
    trajectory, windows = runs(way, [way[:, None] * np.array([0.6, 0.8, 0.0])])
    program = program_of(LINE | {"quaternion_xyzw": UNIT}, windows)

    def convention(of: Any, angles: str | None) -> str | None:
        given = attained(of, program, CertificationSettings(angles=angles), sound(of.time_s), rig_angles=None)
        return given.convention_on_path(given.paths["line"])[0]

    assert convention(trajectory, "kuka-abc") == "kuka-abc"
    poses = trajectory.poses.copy()
    poses[:, 3:] = np.nan
    point = replace(trajectory, poses=poses)
    assert convention(point, "kuka-abc") is None
    # one that nobody knows is refused, though of a path without an orientation there are no angles
    plain = program_of(LINE, windows)
    with pytest.raises(FileFormatError, match=r"angles = 'by-hand' is not a known convention. Use one of "):
        attained(trajectory, plain, CertificationSettings(angles="by-hand"), sound(trajectory.time_s), rig_angles=None)


def test_errors_of_times_are_those_where_a_window_begins_and_where_its_last_tenth_does() -> None:
    """Of one that is short, its last sample."""
    time_s = np.arange(200) / 100.0
    trajectory = trajectory_of(time_s, np.zeros((200, 3)))
    assert places_in(trajectory, ((0.2, 0.59), (1.0, 1.02), (1.5, 1.5)), "A").tolist() == [20, 56, 100, 102, 150, 150]


@pytest.mark.parametrize(("saddle", "reported"), [(22.4, False), (22.9, True)])
def test_a_robot_is_beside_its_poses_where_a_frame_explains_two_thirds_of_how_far_it_is_from_all(saddle: float, reported: bool) -> None:
    """A square 90 mm aside, so that half of its corners are 10 mm from the next, and bent like a saddle, which no frame makes good: a
    third of the root of (10^2 + 90^2) / 2 + s^2 is s for s = 22.6 mm."""
    commanded = {"A": (0.0, 0.0, 0.0), "B": (100.0, 0.0, 0.0), "C": (100.0, 100.0, 0.0), "D": (0.0, 100.0, 0.0)}
    places = {name: (x + 90.0, y, saddle if name in "AC" else -saddle) for name, (x, y, _) in commanded.items()}
    if not reported:
        assert set(attain_at(places, commanded).poses) == set("ABCD")
        return
    with pytest.raises(CertificationError, match=r"pose A, cycle 1: .* mm from B: it is so far from all poses"):
        attain_at(places, commanded)


@pytest.mark.parametrize(("miss", "said"), [(22.0, "the program runs in another order"), (22.5, "it is so far from all poses")])
def test_a_robot_is_far_from_all_poses_where_it_misses_them_by_a_ninth_of_how_far_it_is_from_its_own(miss: float, said: str) -> None:
    """It rests just at B where the program says A, 200 mm from there."""
    commanded = {"A": (0.0, 0.0, 0.0), "B": (200.0, 0.0, 0.0), "C": (0.0, 200.0, 0.0), "D": (0.0, 0.0, 200.0), "E": (200.0, 200.0, 200.0)}
    off = {"A": (200.0, 0.0, 0.0), "B": (0.0, miss, 0.0), "C": (miss, 0.0, 0.0), "D": (0.0, miss, 0.0), "E": (0.0, -miss, 0.0)}
    places = {name: tuple(np.add(commanded[name], by).tolist()) for name, by in off.items()}
    with pytest.raises(CertificationError, match=f"pose A, cycle 1: .* is 200 mm from A and 0 mm from B: {said}"):
        attain_at(places, commanded)
