"""What was typed wrongly is refused in plain words, in the language of the terminal as far as the parser says it."""

import json

import pytest

from lmeasure.cli.app import main
from lmeasure.cli.terminal import state_line
from lmeasure.text import Lines, message


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("zone rig.toml --out z.nc --limit-deg 0,5", "'--limit-deg': must be a number, is '0,5'; a number has a point"),
        ("plan-poses rig.toml --out p.csv --poses 3.5", "'--poses': must be a whole number, is '3.5'"),
        ("plan-poses rig.toml --out p.csv --poses 0", "'--poses': must be at least 1, is '0'"),
        ("zone rig.toml --out z.nc --tilt-steps 0", "'--tilt-steps': must be at least 1, is '0'"),
        ("plan-poses rig.toml --poses 3 --out p.csv --tilt-deg 91", "'--tilt-deg': must be at most 90, is '91'"),
    ],
)
def test_a_number_that_cannot_be_taken_is_refused_in_plain_words(
    words: str, text: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def error(*more: str) -> tuple[str, str]:
        monkeypatch.setattr("sys.argv", ["lmeasure", *words.split(), *more])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2
        return capsys.readouterr()

    assert f"Invalid value for {text}" in error()[1]
    assert json.loads(error("--json")[0])["error"] == f"Invalid value for {text}"
    monkeypatch.setenv("LANGUAGE", "ru")
    assert "Недопустимое значение '--" in error()[1]


def test_lines_between_keys_are_in_the_readers_language(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("LANGUAGE", "ru")
    with state_line() as (say, _):
        say(message("capture.nothing_take_back"))
        say(Lines([message("capture.nothing_take_back"), "one of no catalogue"]))
    assert capsys.readouterr().out == "отменять нечего\nотменять нечего\none of no catalogue\n"
