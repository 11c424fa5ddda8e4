"""Runs that start from lengths: the assembly is chosen by what is stated, or nothing is."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from cells import START, FloatArray, cell, motion, position_error, record

from lmeasure.core import FileFormatError, LMeasureError
from lmeasure.io import files
from lmeasure.recording import read_run, write_run
from lmeasure.rig import Rig, read_rig
from lmeasure.sensors import lengths_from_counts, span_lengths, span_rows
from lmeasure.structure import linkage_of
from lmeasure.structure.measures import along
from lmeasure.trajectory import RunModel, covariances, reconstruct, reconstruction_of
from lmeasure.trajectory.reconstruction.screw_method import by_monte_carlo, other_near

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"


def folder(path: Path, rig: Rig, start: Mapping[str, object], n: int = 200) -> FloatArray:
    """A run folder whose [start] is as given; the true poses."""
    times, poses = motion(n)
    write_run(path, record(rig, times, poses))
    data = files.read_toml(path / "run.toml")
    files.write_toml(path / "run.toml", data | {"start": dict(start)})
    return poses


def lengths_of(rig: Rig, start: FloatArray = START) -> dict[str, float]:
    return dict(zip((c.name for c in rig.cable), span_lengths(rig, start[None])[0].tolist(), strict=True))


def test_lengths_and_about_where_the_tool_is_give_the_start(tmp_path: Path) -> None:
    rig = cell()
    about = {"lengths_mm": lengths_of(rig), "position_mm": [15.0, -10.0, 20.0], "quaternion_xyzw": [0.0, 0.06, 0.08, 0.99498743710662]}
    truth = folder(tmp_path, rig, about)
    run = read_run(tmp_path)
    np.testing.assert_allclose(run.known_start, START, atol=1e-9)
    assert position_error(reconstruct(run).poses, truth).max() < 0.02


def test_the_rigs_side_and_place_alone_may_be_enough(tmp_path: Path) -> None:
    rig = cell(side=(0.0, 0.0, -1.0))
    folder(tmp_path, rig, {"lengths_mm": lengths_of(rig), "position_mm": [0.0, 0.0, 0.0]})
    np.testing.assert_allclose(read_run(tmp_path).known_start, START, atol=1e-9)


def test_what_nothing_chooses_is_listed(tmp_path: Path) -> None:
    rig = cell()
    folder(tmp_path, rig, {"lengths_mm": lengths_of(rig)})
    with pytest.raises(
        FileFormatError, match=r"run.toml: start: lengths_mm fit assemblies, \d: .*\(0.0, .*0.0\) mm.*. State the approximate position_mm"
    ):
        read_run(tmp_path)


def test_where_assemblies_may_have_been_missed_only_a_stated_place_chooses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import lmeasure.linkages.wrapped_links as search

    monkeypatch.setattr(search, "MET", 10**6)  # never met often enough
    rig = cell(side=(0.0, 0.0, -1.0))
    folder(tmp_path, rig, {"lengths_mm": lengths_of(rig), "position_mm": [0.0, 0.0, 0.0]})
    np.testing.assert_allclose(read_run(tmp_path).known_start, START, atol=1e-9)
    folder(tmp_path, rig, {"lengths_mm": lengths_of(rig)})
    with pytest.raises(FileFormatError, match=r"assembl.*\(there may be others\). State the approximate position_mm"):
        read_run(tmp_path)


def test_lengths_that_no_pose_has_are_refused(tmp_path: Path) -> None:
    rig = cell()
    folder(tmp_path, rig, {"lengths_mm": dict.fromkeys(lengths_of(rig), 20.0)})
    with pytest.raises(FileFormatError, match="no pose of rig 'cell' was found that has these lengths_mm"):
        read_run(tmp_path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"c1": -3.0}, "c1 = -3 is not a length"),
        ({"c1": "long"}, "c1: must be a number"),
        ({"c7": 900.0}, "must give the length of each cable: c1, c2, c3, c4, c5, c6"),
    ],
)
def test_lengths_that_are_none_are_refused(tmp_path: Path, change: dict[str, object], said: str) -> None:
    rig = cell()
    folder(tmp_path, rig, {"lengths_mm": lengths_of(rig) | change})
    with pytest.raises(LMeasureError, match=said):
        read_run(tmp_path)


def test_an_orientation_alone_is_no_place(tmp_path: Path) -> None:
    rig = cell()
    folder(tmp_path, rig, {"lengths_mm": lengths_of(rig), "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]})
    with pytest.raises(FileFormatError, match="an orientation without position_mm"):
        read_run(tmp_path)


def test_uncertain_lengths_make_the_whole_run_uncertain(tmp_path: Path) -> None:
    """A length that is off at the start is off by as much all along; Monte Carlo agrees."""
    rig = cell(None)
    folder(
        tmp_path,
        rig,
        {"lengths_mm": lengths_of(rig), "position_mm": [0.0, 0.0, 0.0], "quaternion_xyzw": [0, 0, 0, 1], "u_length_mm": 0.2},
        3,
    )
    run = read_run(tmp_path)
    assert run.u_start == (None, None, 0.2)
    assert run.start_errors.u == (0.0, 0.0, 0.2)
    found = reconstruct(run)
    budget = covariances(found, run)
    assert set(budget.sources) == {"start pose"}
    reconstruction = reconstruction_of(RunModel(run.rig, run.known_start, u_start=run.start_errors.u))
    drawn = by_monte_carlo(reconstruction, lengths_from_counts(run), found, 300, seed=1)
    u = np.sqrt(np.einsum("nii->ni", found.systematic))
    np.testing.assert_allclose(np.sqrt(np.einsum("nii->ni", drawn.systematic)), u, rtol=0.17)
    assert u[0, 3:].max() > 0.1


def test_a_start_near_a_fold_is_told_with_the_other_assembly() -> None:
    """On both sides of a singular pose the other one is found, with the same lengths and twice as far; away from it nothing is said."""
    rig = read_rig(TRUTH / "cell-run" / "rig.toml")
    rows, home, beyond = rig.cable_rows(), np.array([0.0, 0, 0, 0, 0, 0, 1]), np.array([900.0, -1000, 200, 0, 0, 0, 1])
    (share,) = along(linkage_of(rig), home, beyond)["singular_at_share"]
    assert other_near(rows, home, 50.0) is None
    far = float(np.linalg.norm(beyond[:3]))
    for step in (-4.0, 4.0):
        start = home + np.append((share + step / far) * beyond[:3], np.zeros(4))
        found = other_near(rows, start, 50.0)
        assert found is not None
        pose, apart = found
        np.testing.assert_allclose(span_rows(rows, pose[None])[0], span_rows(rows, start[None])[0], atol=1e-6)
        sides = np.sign(np.linalg.det(span_rows(rows, np.stack([start, pose]))[1]))
        assert sides[0] == -sides[1]
        assert 0.5 * apart < 4.0 < apart
        (note,) = [n for n in reconstruction_of(RunModel(rig, start)).notes if n.code == "start.near"]
        assert note.values["apart_mm"] == apart
    assert not any(n.code == "start.near" for n in reconstruction_of(RunModel(rig, home)).notes)
