"""Findings: the same words in every language, made of codes and values; texts from files are known again by the catalogue."""

import json
import re

import pytest

from lmeasure.text import Message, Say, from_stated, message, plain, recognised

STEP = "channel ch3 (cable c3) stepped by -200 counts (+2.400 mm) between 10.39 and 11.6 s"
RUSSIAN = "канал ch3 (трос c3): скачок на -200 отсч. (+2,400 мм) между 10,39 и 11,6 с"


@pytest.mark.parametrize(
    ("english", "russian"),
    [
        (f"counts suspected lost: {STEP}", f"возможна потеря отсчётов: {RUSSIAN}"),
        (
            f"suspected: {STEP}; poses after that hang on it, and get no verdict",
            f"возможна потеря отсчётов: {RUSSIAN}; позы после этого зависят от неё и остаются без заключения",
        ),
        (
            "pose a{0}b: angles 'x' are singular at the commanded orientation; 'y' instead",
            "поза a{0}b: углы 'x' вырождены при заданной ориентации; вместо них 'y'",
        ),
        ("pass 1: the recording ended early: no bus", "проход 1: запись оборвалась: no bus"),
        ("pass 1: the recording ended early", "проход 1: запись оборвалась"),
        (
            "pass 1: faults while it was recorded: 1 bus_error, 2 overflow",
            "проход 1: сбои при записи: ошибок шины 1 (bus_error), переполнений очереди 2 (overflow)",
        ),
        ("pass 1: faults while it was recorded: 3 odd", "проход 1: сбои при записи: 3 odd"),
    ],
)
def test_texts_from_files_are_known_again(english: str, russian: str) -> None:
    found = recognised(english)
    assert found is not None
    assert str(found) == english
    assert found.text("ru") == russian


def test_what_is_no_text_of_the_catalogue_is_not_known() -> None:
    assert recognised("something else") is None
    assert recognised("worst pressure angle of 71.2 deg; the zone ends at 60 deg") is None
    # a word where a number stands
    assert recognised("limit band wide mm") is None


ZONE = message("zone.angle", angle_deg=71.234, limit_deg=60.0)
NESTED = message("excluded.part", part=message("subject.pose", name="P1"), reason=ZONE)
COVERS = message("covers.run.uncalibrated", sources=(message("source.counts"), message("source.clock", number=2), "another"))


def test_words_are_made_of_values_at_the_end() -> None:
    assert str(ZONE) == "worst pressure angle 71.2 deg; the zone ends at 60 deg"
    assert NESTED.text("ru") == "поза P1: наибольший угол давления 71,2°; граница зоны 60°"
    assert str(COVERS) == "the resolution of the counts, clock of pass 2, another; not the calibration: the rig links none"
    assert COVERS.text("ru").startswith("дискретность отсчётов, часы прохода 2, another; кроме калибровки")


@pytest.mark.parametrize("told", [ZONE, NESTED, COVERS])
def test_what_a_certificate_states_of_a_finding_gives_it_again(told: Message) -> None:
    stated = json.loads(json.dumps(told.stated()))
    assert from_stated(stated) == told
    # neither another text, nor an unknown code, nor a value less, is put into words
    for forged in (stated | {"text": "all is well"}, stated | {"code": "none"}, stated | {"values": {}}, {"text": stated["text"]}):
        assert from_stated(forged) is None


FAULTS = (
    "steps of a counter by 37 counts (0.45 mm) and more are seen, the acceleration of the motion itself, 1110 mm/s2, being the limit",
    "steps of a counter by 370 counts (4.5 mm) and more are seen, the acceleration of the motion itself, 1100 mm/s2, being the limit; "
    "it is sampled too slowly for its speed to show smaller ones",
    "steps of counters are not seen: no channel has four counts on end",
    "steps of a counter by 37 counts (0.45 mm) and more are seen, the acceleration of the motion itself, 1110 mm/s2, being the limit; "
    "of ch2, ch3, without four counts on end, none are",
    "one cable to spare, 7 cables for 6 unknowns: that lengths contradict each other is seen, but not which of them is wrong",
    "2 cables to spare, 8 cables for 6 unknowns: one that contradicts the others is seen and left out",
    "channel ch2 stepped by about +1000 counts (within 25) between 4.48 and 4.484 s: its origin is lost, and it errs again at 13.48 s",
    "channel ch2 stood up to 4.48 s and counts again: its origin is lost",
    "channel ch2 does not follow the tool between 4.4 and 4.5 s, which goes on evenly: its origin is lost; but it is back where it was at "
    "the rest at 4.728 s: it has lost nothing",
    "channel ch4 stepped by about +700 counts (within 12) between 2.396 and 2.4 s: its origin is lost; but the other cables show that it "
    "has lost nothing",
    "channel ch3 stands from 0 s on while its point is drawn far: it does not count",
    "channel ch3 was elsewhere for a moment behind 2.5 s",
    "channel ch3 was elsewhere for a moment, 3 times, first behind 2.5 s",
    "all channels step as if the clock had, behind 3.996 s",
    "from 12.5 s to the end: cable c3 does not follow the other cables, by up to +3.01 mm (standard uncertainty 0.012 mm), and is left out",
    "from 12.5 s to the end: cable c3 does not follow the other cables, and is left out",
    "from the beginning to the end: the cables contradict each other, and no single one explains it",
    "from the beginning to 3.5 s: the cables contradict each other: c1 or c2 is wrong, and which cannot be told",
    "from the beginning to 3.5 s: the cables contradict each other, and which is wrong cannot be told",
    str(message("rig.uncalibrated")),
)


@pytest.mark.parametrize("text", FAULTS)
def test_what_is_said_of_counters_is_said_in_russian(text: str) -> None:
    found = recognised(text)
    assert found is not None
    assert str(found) == text
    told = found.text("ru")
    assert not re.search(r"[a-z]{4,}", told.replace("`lmeasure calibrate`", "").replace("c1 or c2", "")), told


def test_large_numbers_have_no_power_of_ten() -> None:
    limit = message("steps.seen", counts=37.2, mm=0.45, mm_s2=4384.2)
    assert "the motion itself, 4380 mm/s2, being" in str(limit)
    assert "4380" in limit.text("ru")
    assert (
        plain("-1.234e+04 to 2e+06, 1e+09, 1.5e-05, x1e+03, 1.2e+031, 1e+00")
        == "-12340 to 2000000, 1e+09, 1.5e-05, x1e+03, 1.2e+031, 1e+00"
    )
    assert Say("ru").number(12345.6, ".3g") == "12300"
    assert Say().message("residuals of 1.11e+03 mm") == "residuals of 1110 mm"
    # a trajectory written before, and a certificate's code beside such a text
    old = "steps of a counter by 37 counts (0.45 mm) and more are seen, the acceleration of the motion itself, 4.38e+03 mm/s2, being the limit"  # noqa: E501
    found = recognised(old)
    assert found is not None
    assert str(found) == str(limit)
