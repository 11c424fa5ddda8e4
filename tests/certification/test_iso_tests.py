"""The table of tests: a new test of the standard is one class and one line, and what is asked of a test changes nothing."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from made_trajectories import StatedErrors, by_name, made_campaign

from lmeasure.arrays import FloatArray
from lmeasure.certification import Settings, evaluate, iso9283
from lmeasure.certification.attainment import Attainment, attained
from lmeasure.certification.figure import Figure, Maker, Subject
from lmeasure.certification.iso_test import IsoTest
from lmeasure.program import Program
from lmeasure.trajectory.stamps import sound

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
    trajectory, program = made_campaign(np.array([0.3, 0.0, 0.0]), 0.05, cycles=8)
    model = Program.model_validate(program)
    before = evaluate(trajectory, model, LAW, settings=Settings(trials=200))
    monkeypatch.setattr(iso9283, "TESTS", (*iso9283.TESTS, farthest))
    after = evaluate(trajectory, model, LAW, settings=Settings(trials=200))
    found = by_name(after)
    for name in ("P1", "P2"):
        pose = next(p for p in after.poses if p.name == name)
        assert found["F", name].value == pytest.approx(np.linalg.norm(pose.poses[:, :3] - pose.commanded[:3], axis=1).max(), rel=1e-12)
        assert 0.005 < found["F", name].u95 < 0.04
    # with the others of its pose, and no figure of theirs is another
    assert [c.name for c in after.characteristics if c.pose == "P1"][-1] == "F"
    assert tuple(c for c in after.characteristics if c.name != "F") == before.characteristics


def test_what_is_asked_of_a_test_and_when_changes_nothing() -> None:
    trajectory, program = made_campaign(np.array([0.3, 0.0, 0.0]), 0.05, cycles=4)
    given = attained(trajectory, Program.model_validate(program), Settings(), sound(trajectory.time_s), rig_angles=None)
    tests = iso9283.tests_of(given)
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
    assert sorted(names) == sorted(f.key for t in iso9283.tests_of(given) for f in t.figures())
