"""Causes of samples: codes in memory, English words in files, known again when they are read, in every language on pages."""

import re

import numpy as np
import pytest
from numpy.typing import NDArray

from lmeasure.text import Cause, Finding, and_also, finding, from_file, in_english, is_of, recognised, within, without

NO_COUNT = finding("cause.no_count", channel="ch7")
TURN = finding("screw.turn", at=(40.0, -25.0, 0.0), along=(0.0, 0.0, 1.0))
DETERMINED = finding("cause.lost.determined", screw=TURN, mm=0.01234, deg=0.0021, shift=(0.1, -0.2, 30.0), turn=(0.0, 0.5, 0.25))
STEP = finding("counts.stepped", channel="ch3", cable="c3", counts=-200.0, mm=2.4, after_s=10.39, before_s=11.6)
SUSPECTED = finding("counts.suspected", step=STEP)
EVERY: list[tuple[Cause, str]] = [
    (NO_COUNT, "channel ch7 has no count"),
    (
        finding("cause.jumped", channel="ch1", key="max_cable_speed_mm_s", limit=20000.0),
        "channel ch1 jumped faster than max_cable_speed_mm_s = 20000 allows",
    ),
    (
        finding("cause.wrapped", channel="a", key="max_speed_deg_s", limit=1e6),
        "channel a may have wrapped unseen at max_speed_deg_s = 1000000",
    ),
    (finding("cause.foreign.bits", channel="a", bits=16), "channel a shows a value that a counter of 16 bits does not have"),
    (finding("cause.foreign.codes", channel="a", codes=4096), "channel a shows a value that an encoder of 4096 codes does not have"),
    (finding("cause.pass.hole", passage=2), "pass 2 has no samples around this time"),
    (finding("cause.without", cause=NO_COUNT), "without it: channel ch7 has no count"),
    (
        finding("joined", first=finding("cause.singular"), then=DETERMINED),
        "the cables do not determine the pose: their Pluecker matrix is singular here or on the way here; not determined: a turn about "
        "the axis through (40.0, -25.0, 0.0) mm along (0.000, 0.000, 1.000); determined since the last pose, within 0.0123 mm and 0.0021 "
        "deg: a shift by (0.100, -0.200, 30.000) mm and a turn by (0.000, 0.500, 0.250) deg",
    ),
    (
        finding("cause.nearly_singular", screw=finding("screw", at=(1.0, 2.0, 3.0), along=(0.6, 0.8, 0.0), mm=-12.0), mm=0.0123),
        "nearly singular: 1 mm of a turn about the axis through (1.0, 2.0, 3.0) mm along (0.600, 0.800, 0.000) that goes -12 mm along it "
        "per turn changes the lengths by 0.012 mm",
    ),
    (
        finding("joined", first=finding("cause.without", cause=NO_COUNT), then=SUSPECTED),
        "without it: channel ch7 has no count; counts suspected lost: channel ch3 (cable c3) stepped by -200 counts (+2.400 mm) between "
        "10.39 and 11.6 s",
    ),
    (finding("cause.restored", cable="c3", after_s=1.25), "restored origin: c3 goes on from another origin behind 1.25 s"),
]


@pytest.mark.parametrize(("cause", "text"), EVERY, ids=[str(i) for i in range(len(EVERY))])
def test_files_hold_english_words_that_are_known_again(cause: Finding, text: str) -> None:
    assert str(cause) == text
    found = recognised(text)
    assert found is not None
    assert str(found) == text
    russian = found.text("ru")
    assert russian == cause.text("ru")
    assert not re.search("[a-z]{4}", re.sub(r"max_\w+", "", russian)), russian


def some(*causes: Cause) -> NDArray[np.object_]:
    out = np.empty(len(causes), dtype=np.object_)
    out[:] = causes
    return out


def test_many_samples_share_what_is_said_of_them() -> None:
    causes = some("", NO_COUNT, "", NO_COUNT, "of another version")
    more = and_also(causes, SUSPECTED)
    assert more[0] is more[2] is SUSPECTED
    assert more[1] is more[3]
    assert in_english(more).tolist() == [
        str(SUSPECTED),
        f"{NO_COUNT}; {SUSPECTED}",
        str(SUSPECTED),
        f"{NO_COUNT}; {SUSPECTED}",
        f"of another version; {SUSPECTED}",
    ]
    assert [within(cause, "counts.suspected") for cause in more] == [SUSPECTED] * 5
    assert [is_of(cause, "cause.no_count") for cause in more] == [False, True, False, True, False]
    assert [str(cause) for cause in without(causes)] == ["without it: ", *(f"without it: {cause}" for cause in causes[1:2]), "without it: ",
        f"without it: {NO_COUNT}", "without it: of another version"]  # fmt: skip


def test_what_a_file_says_in_other_words_stays_its_text() -> None:
    read = from_file(some("", "channel ch7 has no count", "a jump", "channel ch7 has no count"))
    assert read.tolist() == ["", NO_COUNT, "a jump", NO_COUNT]
    assert in_english(read).tolist() == ["", "channel ch7 has no count", "a jump", "channel ch7 has no count"]
    assert within(read[2], "cause.no_count") is None
    assert not is_of("", "cause.no_count")
