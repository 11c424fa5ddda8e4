"""Causes of samples: codes in memory, English words in files, known again when they are read, in every language on pages."""

import json
import re

import numpy as np
import pytest
from numpy.typing import NDArray

from lmeasure.text import Cause, Message, and_also, from_stated, is_of, message, of_file, table, within, without

NO_COUNT = message("cause.no_count", channel="ch7")
TURN = message("screw.turn", at=(40.0, -25.0, 0.0), along=(0.0, 0.0, 1.0))
DETERMINED = message("cause.lost.determined", screw=TURN, mm=0.01234, deg=0.0021, shift=(0.1, -0.2, 30.0), turn=(0.0, 0.5, 0.25))
STEP = message("counts.stepped", channel="ch3", cable="c3", counts=-200.0, mm=2.4, after_s=10.39, before_s=11.6)
SUSPECTED = message("counts.suspected", step=STEP)
EVERY: list[tuple[Message, str]] = [
    (NO_COUNT, "channel ch7 has no count"),
    (
        message("cause.jumped", channel="ch1", key="max_cable_speed_mm_s", limit=20000.0),
        "channel ch1 jumped faster than max_cable_speed_mm_s = 20000 allows",
    ),
    (
        message("cause.wrapped", channel="a", key="max_speed_deg_s", limit=1e6),
        "channel a may have wrapped undetected at max_speed_deg_s = 1000000",
    ),
    (message("cause.foreign.bits", channel="a", bits=16), "channel a has a value outside a 16-bit counter"),
    (message("cause.foreign.codes", channel="a", codes=4096), "channel a has a value outside an encoder of 4096 codes"),
    (message("cause.pass.hole", passage=2), "pass 2 has no samples near this time"),
    (message("cause.without", cause=NO_COUNT), "without it: channel ch7 has no count"),
    (
        message("joined", first=message("cause.singular"), then=DETERMINED),
        "the cables do not determine the pose: it is singular here or on the path to it; not determined: a turn about "
        "the axis through (40.0, -25.0, 0.0) mm along (0.000, 0.000, 1.000). Determined since the last pose, within 0.0123 mm and 0.0021 "
        "deg: a shift by (0.100, -0.200, 30.000) mm and a turn by (0.000, 0.500, 0.250) deg",
    ),
    (
        message("cause.nearly_singular", screw=message("screw", at=(1.0, 2.0, 3.0), along=(0.6, 0.8, 0.0), mm=-12.0), mm=0.0123),
        "nearly singular: 1 mm of a turn about the axis through (1.0, 2.0, 3.0) mm along (0.600, 0.800, 0.000), with -12 mm along it "
        "per turn changes the lengths by 0.012 mm",
    ),
    (
        message("joined", first=message("cause.without", cause=NO_COUNT), then=SUSPECTED),
        "without it: channel ch7 has no count; suspected lost counts: channel ch3 (cable c3) jumped by -200 counts (+2.400 mm) between "
        "10.39 and 11.6 s",
    ),
    (message("cause.restored", cable="c3", after_s=1.25), "restored origin: c3 continues from another origin after 1.25 s"),
]


@pytest.mark.parametrize(("cause", "text"), EVERY, ids=[str(i) for i in range(len(EVERY))])
def test_a_cause_is_its_english_text_and_knows_others(cause: Message, text: str) -> None:
    assert cause == text
    russian = cause.text("ru")
    assert not re.search("[a-z]{4}", re.sub(r"max_\w+", "", russian)), russian
    assert from_stated(json.loads(json.dumps(cause.stated()))) == cause


def some(*causes: Cause) -> NDArray[np.object_]:
    out = np.empty(len(causes), dtype=np.object_)
    out[:] = causes
    return out


def test_many_samples_share_what_is_said_of_them() -> None:
    causes = some("", NO_COUNT, "", NO_COUNT, "of another version")
    more = and_also(causes, SUSPECTED)
    assert more[0] is more[2] is SUSPECTED
    assert more[1] is more[3]
    assert more.tolist() == [
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


def test_texts_of_a_file_are_messages_where_it_keeps_their_ids() -> None:
    stated = table([NO_COUNT])
    read = of_file(some("", "channel ch7 has no count", "a jump"), stated)
    assert read.tolist() == ["", NO_COUNT, "a jump"]
    assert within(read[1], "cause.no_count") is read[1]
    assert within(read[2], "cause.no_count") is None
    assert within(of_file(read.astype(str).astype(object), [])[1], "cause.no_count") is None
    assert not is_of("", "cause.no_count")
