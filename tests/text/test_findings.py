"""Findings: the same words in every language, made of codes and values; texts from files are known again by the catalogue."""

import json

import pytest

from lmeasure.text import Message, Say, from_stated, message, plain

ZONE = message("zone.angle", angle_deg=71.234, limit_deg=60.0)
NESTED = message("excluded.part", part=message("subject.pose", name="P1"), reason=ZONE)
COVERS = message("covers.run.uncalibrated", sources=(message("source.counts"), message("source.clock", number=2), "another"))


def test_words_are_made_of_values_at_the_end() -> None:
    assert str(ZONE) == "worst pressure angle 71.2 deg. The zone ends at 60 deg"
    assert NESTED.text("ru") == "поза P1: наибольший угол давления 71,2°. Граница зоны 60°"
    assert (
        str(COVERS) == "the resolution of the counts, clock of pass 2, another. The calibration is not included: the rig has no link to one"
    )
    assert COVERS.text("ru").startswith("дискретность отсчётов, часы прохода 2, another. Калибровка не учтена")


@pytest.mark.parametrize("reported", [ZONE, NESTED, COVERS])
def test_what_a_certificate_states_of_a_finding_gives_it_again(reported: Message) -> None:
    stated = json.loads(json.dumps(reported.stated()))
    assert from_stated(stated) == reported
    # neither another text, nor an unknown code, nor a value less, is put into words
    for forged in (stated | {"text": "all is well"}, stated | {"code": "none"}, stated | {"values": {}}, {"text": stated["text"]}):
        assert from_stated(forged) is None


def test_large_numbers_have_no_power_of_ten() -> None:
    limit = message("steps.seen", counts=37.2, mm=0.45, mm_s2=4384.2)
    assert "or more are detected. The limit comes from the motion's own acceleration, 4380 mm/s2" in str(limit)
    assert "4380" in limit.text("ru")
    assert (
        plain("-1.234e+04 to 2e+06, 1e+09, 1.5e-05, x1e+03, 1.2e+031, 1e+00")
        == "-12340 to 2000000, 1e+09, 1.5e-05, x1e+03, 1.2e+031, 1e+00"
    )
    assert Say("ru").number(12345.6, ".3g") == "12300"
    assert Say().message("residuals of 1.11e+03 mm") == "residuals of 1110 mm"
