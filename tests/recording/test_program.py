"""Programs: what a program.toml may say, and what is refused in one line."""

import re
from pathlib import Path

import numpy as np
import pytest

from lmeasure.core import FileFormatError
from lmeasure.recording import read_program, write_program

WHOLE = (Path(__file__).parent / "inputs" / "program.toml").read_text(encoding="utf-8")


def test_everything_a_program_can_say(tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text(WHOLE)
    program = read_program(tmp_path / "p.toml")
    assert program.distance[0].name == "P1-P2"
    assert program.drift[0].group == 10
    assert program.compliance[0].force_n[1] == (10.0, 0.0, 0.0)
    np.testing.assert_array_equal(program.path[0].corners(), [[0, 0, 0], [100, 0, 0]])
    write_program(tmp_path / "again.toml", program)
    assert read_program(tmp_path / "again.toml") == program


def test_a_program_that_has_not_run_says_approaches_and_forces_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text(re.sub(r"(?m)^windows_s = .*\n", "", WHOLE))
    program = read_program(tmp_path / "p.toml")
    assert program.pose[0].approaches == ("x", "y")
    assert program.compliance[0].force_n[1] == (10.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('name = "P2"', 'name = "P1"', "the name 'P1' is given 2 times"),
        ('name = "P2"', 'name = "P\\n2"', "must be one line of printable text"),
        ("windows_s = [[1.0, 2.0], [5.0, 6.0]]", "windows_s = [[1.0, 2.0], [1.5, 6.0]]", "window 2 starts at 1.5 s"),
        ("windows_s = [[1.0, 2.0], [5.0, 6.0]]", "windows_s = [[2.0, 1.0], [5.0, 6.0]]", "does not end after its start"),
        ("windows_s = [[1.0, 2.0], [5.0, 6.0]]", "windows_s = [[1.0, 2.0]]", "has 1 window for 2 cycles"),
        ("windows_s = [[3.0, 4.0]]", "windows_s = [[1.5, 2.5]]", "before one of P1 ends at 2 s"),
        ("windows_s = [[3.0, 4.0]]", "windows_s = [[3.0, nan]]", "finite number"),
        ('approaches = ["x", "y"]', 'approaches = ["x"]', "1 approaches for 2 windows"),
        ('angles = "kuka-abc"', 'angles = "abc"', "angles: 'abc' is not one of"),
        ('to = "P2"', 'to = "P3"', "no pose 'P3'"),
        ("upper = 0.5", "upper = 0.5\nlower = 0.6", "is not below"),
        ("upper = 0.5", "", "needs lower, upper or both"),
        ("force_n = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]", "force_n = [[0.0, 0.0, 0.0]]", "1 force_n for 2 windows_s"),
        ("weave_stroke_mm = 5.0", "", "a weave is a linear path"),
        ("end_mm = [100.0, 0.0, 0.0]", "end_mm = [0.0, 0.0, 0.0]", "is the one before it again"),
        ("speed_mm_s = 50.0", "radius_mm = 50.0", "has no radius_mm"),
        ("speed_mm_s = 50.0", "speed_mms = 50.0", "unknown key 'speed_mms'. Did you mean 'speed_mm_s'"),
        ("[0.0, 0.0, 0.0, 1.0]", "[0.0, 0.0, 0.0, 1.1]", "is not of length 1 but 1.1"),
        ("cycles = 2", 'cycles = "2"', "cycles: must be a whole number"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in WHOLE
    (tmp_path / "p.toml").write_text(WHOLE.replace(old, new))
    with pytest.raises(FileFormatError) as caught:
        read_program(tmp_path / "p.toml")
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "p.toml"))
    assert "\n" not in str(caught.value)
