"""What is said of counts that are suspected, of closures and of the recording, in Russian."""

import pytest

from lmeasure.report.sentences import sentence

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
            "the resolution of the counts, closure of the counts, calibration",
            "дискретность отсчётов, незамыкание отсчётов, калибровка установки",
        ),
        ("pass 1: the recording ended early: no bus", "проход 1: запись оборвалась: no bus"),
        ("pass 1: the recording ended early", "проход 1: запись оборвалась"),
    ],
)
def test_sentences(english: str, russian: str) -> None:
    told = sentence("ru", english)
    assert told is not None
    assert told.replace("−", "-") == russian
