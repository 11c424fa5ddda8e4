"""The table of tests: a new test of the standard is one class and one line, and what is asked of a test changes nothing."""

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
import pytest
from synthetic_trajectories import StatedErrors, by_name, synthetic_campaign

from lmeasure.core import FloatArray
from lmeasure.iso9283 import CertificationSettings, clauses, evaluate
from lmeasure.iso9283.attainment import Attainment, attained
from lmeasure.iso9283.clause import Clause, IsoTest
from lmeasure.iso9283.clauses import distance
from lmeasure.iso9283.clauses.corners import CornerPart
from lmeasure.iso9283.clauses.path import PathPart
from lmeasure.iso9283.clauses.pose import PosePart, _reduced
from lmeasure.iso9283.figure import Figure, Maker, Subject
from lmeasure.recording import Program
from lmeasure.trajectory.time.stamps import sound

LAW = StatedErrors(np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]) * 0.01**2)


@dataclass(frozen=True, kw_only=True)
class FarthestTest(IsoTest):
    """An invented test: how far the farthest cycle of a pose is from where it was sent."""

    commanded: FloatArray
    cycles: int

    def figures(self) -> list[Figure]:
        """See `IsoTest`."""
        key, commanded = self.subject, self.commanded
        make = Maker(cycles=self.cycles, needs=(key,), pose=key.name)
        return [make.one("F", "none", "mm", lambda s: np.linalg.norm(s[key].position - commanded, axis=-1).max(axis=-1))]


def farthest(given: Attainment) -> Iterator[FarthestTest]:
    for name, pose in given.poses.items():
        yield FarthestTest(subject=Subject("pose", name), commanded=pose.commanded[:3], cycles=len(pose.poses))


def test_a_new_test_is_one_class_and_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    trajectory, program = synthetic_campaign(np.array([0.3, 0.0, 0.0]), 0.05, cycles=8)
    model = Program.model_validate(program)
    before = evaluate(trajectory, model, LAW, settings=CertificationSettings(trials=200))
    monkeypatch.setattr(clauses, "CLAUSES", (*clauses.CLAUSES, Clause(tests=farthest, quantities=())))
    after = evaluate(trajectory, model, LAW, settings=CertificationSettings(trials=200))
    found = by_name(after)
    for name in ("P1", "P2"):
        pose = next(p for p in after.poses if p.name == name)
        assert found["F", name].value == pytest.approx(np.linalg.norm(pose.poses[:, :3] - pose.commanded[:3], axis=1).max(), rel=1e-12)
        assert 0.005 < found["F", name].u95 < 0.04
    # with the others of its pose, and no figure of theirs is another
    assert [c.name for c in after.characteristics if c.pose == "P1"][-1] == "F"
    assert tuple(c for c in after.characteristics if c.name != "F") == before.characteristics


def test_what_is_asked_of_a_test_and_when_changes_nothing() -> None:
    trajectory, program = synthetic_campaign(np.array([0.3, 0.0, 0.0]), 0.05, cycles=4)
    given = attained(trajectory, Program.model_validate(program), CertificationSettings(), sound(trajectory.time_s), rig_angles=None)
    tests = clauses.tests_of(clauses.CLAUSES, given)
    errors = [LAW, StatedErrors(np.zeros((6, 6)))]

    def states(model: StatedErrors) -> dict[Subject, FloatArray]:
        parts = {k: p for t in tests for k, p in t.parts(lambda samples: model.at(trajectory, samples)[0]).items()}
        return {k: p.state(np.zeros((len(p.errors), 6)), reduced=True).position for k, p in parts.items()}

    first = [states(model) for model in errors]
    names = [f.key for t in reversed(tests) for f in t.figures()][::-1]
    again = [states(model) for model in reversed(errors)][::-1]
    for one, other in zip(first, again, strict=True):
        assert all(np.array_equal(one[k], other[k]) for k in one)
    assert not np.array_equal(first[0][Subject("pose", "P1")], first[1][Subject("pose", "P1")])
    assert sorted(names) == sorted(f.key for t in clauses.tests_of(clauses.CLAUSES, given) for f in t.figures())


def test_one_direction_and_one_robot_vary_from_no_other() -> None:
    trajectory, program = synthetic_campaign(np.array([0.3, 0.0, 0.0]), 0.05, cycles=4)
    program["pose"][0] |= {"approaches": ["up"] * 4, "units": ["A"] * 4}
    program["pose"][1] |= {"approaches": ["up", "down"] * 2, "units": ["A", "A", "B", "B"]}
    program["drift"] = [{"pose": "P1", "group": 4}, {"pose": "P2", "group": 2}]
    given = attained(trajectory, Program.model_validate(program), CertificationSettings(), sound(trajectory.time_s), rig_angles=None)
    keys = {(f.key.name, f.key.pose) for t in clauses.tests_of(clauses.CLAUSES, given) for f in t.figures()}
    names = "vAP_p", "E", "dAP_p", "dRP_l"
    assert {key for key in keys if key[0] in names} == {(name, "P2") for name in names}


def test_of_exact_positions_the_scatter_is_the_least_that_is_likely_of_as_many() -> None:
    values, none = np.random.default_rng(2).normal(size=(6, 3)), np.zeros((3, 3))
    found, mean = _reduced(values, [none, none, none], np.zeros(6, np.int64)), values.mean(axis=0)
    # nothing is added to the mean; a mean square of five degrees of freedom is known to 1.64 times the root of two fifths
    np.testing.assert_allclose(found, mean + (values - mean) / np.sqrt(1.0 + 1.6449 * np.sqrt(2.0 / 5.0)), rtol=1e-4)


@pytest.mark.parametrize(
    ("names", "ends"), [(("P1", "P3"), ["P1", "P3"]), (("P1", "P3", "P4"), ["P1", "P3"]), (("P1", "P2", "P3", "P4"), ["P2", "P4"])]
)
def test_a_distance_that_nobody_asks_for_is_that_of_the_standard(names: tuple[str, ...], ends: list[str]) -> None:
    """Of the first two poses where those of the standard are missing; none between poses of different numbers of cycles."""
    trajectory, program = synthetic_campaign(np.zeros(3), 0.05, cycles=2, names=names)

    def found() -> list[list[str]]:
        given = attained(trajectory, Program.model_validate(program), CertificationSettings(), sound(trajectory.time_s), rig_angles=None)
        return [[end.name for end in t.ends] for t in distance.tests(given)]

    assert found() == [ends]
    first = next(p for p in program["pose"] if p["name"] == ends[0])
    first["windows_s"] = first["windows_s"][:1]
    assert found() == []


def test_a_cycle_that_is_a_group_alone_has_no_scatter() -> None:
    values, law = np.array([[3.0, 0.0, 0.0], [3.2, 0.0, 0.0], [5.0, 0.0, 0.0]]), np.diag([1e-4, 1e-4, 1e-4])
    found = _reduced(values, [law, law / 3.0, law / 2.0, law], np.array([0, 0, 1]))
    assert np.isfinite(found).all()
    # the two scatter less about their mean than they were measured to, the third is moved with its mean alone
    assert 0.0 < found[1, 0] - found[0, 0] < 0.2
    assert found[2, 0] == pytest.approx(5.0, abs=0.05)


@pytest.mark.parametrize("part", [PosePart, PathPart, CornerPart])
def test_what_a_part_works_out_is_nothing_to_be_given(part: type) -> None:
    own = [f for f in fields(part) if f.name.startswith("_")]
    assert own
    assert not any(f.init for f in own)
