"""Which methods gave which runs the figures of today: certificates by these are compared to the digit, others are shown beside today's."""

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lmeasure.certification import method
from lmeasure.certification.method import METHOD, contradicted, late, lost, method_of, same_figures
from lmeasure.findings import finding
from lmeasure.run import read_run
from lmeasure.simulation import cell_rig
from lmeasure.status import Status

WHAT = ("passes", "linked", "rough", "contradicted", "lost", "late")


def test_every_method_is_described_where_its_number_stands() -> None:
    described = [int(number) for number in re.findall(r"(?<![\w.])(\d+): ", method.__doc__ or "")]
    assert described == list(range(1, METHOD + 1))


@pytest.mark.parametrize(
    ("what", "first"),
    [
        (set(), 3),
        ({"passes"}, 4),
        ({"linked"}, 5),
        ({"passes", "linked"}, 5),
        ({"rough"}, 7),
        ({"contradicted"}, 7),
        ({"passes", "rough"}, 7),
        ({"linked", "contradicted"}, 7),
        ({"lost"}, 8),
        ({"lost", "passes"}, 8),
        ({"late"}, 9),
        ({"late", "lost"}, 9),
    ],
)
def test_methods_of_the_same_figures_begin_where_the_last_thing_changed_that_a_run_has(what: set[str], first: int) -> None:
    """Of what it has not, nothing matters; a method that comes after today's is not known."""
    found = [m for m in range(METHOD + 3) if same_figures(m, **{name: name in what for name in WHAT})]
    assert found == list(range(first, METHOD + 1))


def test_what_a_run_has_more_never_makes_an_earlier_method_the_same() -> None:
    every = [dict(zip(WHAT, so, strict=True)) for so in itertools.product((False, True), repeat=6)]
    for less, more in itertools.product(every, every):
        if all(more[name] for name in WHAT if less[name]):
            assert all(same_figures(m, **less) for m in range(1, METHOD + 1) if same_figures(m, **more))


def test_six_drums_lose_a_run_as_they_always_did() -> None:
    """Seven of them, or five and an encoder, have since method 8."""
    six, status = cell_rig(1), np.array([Status.OK, Status.SINGULAR, Status.OTHER_ASSEMBLY])
    point = six.model_copy(update={"cable": tuple(c.model_copy(update={"to_point": six.cable[0].to_point}) for c in six.cable)})
    five = six.model_copy(update={"cable": six.cable[:5]})
    assert not lost(six, status)
    for rig in (point, five):
        assert lost(rig, status)
        assert lost(rig, status[[0, 2]])
        assert lost(rig, status[:2])
        assert not lost(rig, np.array([Status.OK, Status.GAP, Status.JUMP]))


def test_a_certificate_without_a_method_is_by_the_first() -> None:
    assert method_of({}) == 1
    assert method_of({"method": 5}) == 5


def test_a_run_contradicts_itself_where_a_finding_says_so_and_not_where_a_text_does() -> None:
    other, said = finding("angles.none", part="pose P1", angles="kuka-abc"), finding("channels.contradict", begin="0", end="1", said="ch1")
    assert not contradicted([])
    assert not contradicted([other, str(said)])
    assert contradicted([str(other), other, said])


def test_a_run_is_late_where_a_host_stamped_it_so() -> None:
    """Rows that are not there leave whole intervals, which are as even as others."""
    even = read_run(Path(__file__).parents[1] / "authorities" / "truth" / "cell-run")
    counts = even.passes[0]
    time_s = counts.time_s
    assert not late(even)
    kept = np.delete(np.arange(len(time_s)), [50, 51, 200])
    assert not late(replace(even, passes=(replace(counts, time_s=time_s[kept], recorded=counts.recorded[kept]),)))
    stamped = time_s.copy()
    stamped[100] += 0.0004
    assert late(replace(even, passes=(counts, replace(counts, time_s=stamped))))
    assert not late(replace(even, passes=(replace(counts, time_s=time_s[:1], recorded=counts.recorded[:1]),)))
