"""Everything that is wrong with a file at once, each with its line: TOML, and the tables beside it."""

import random
import tomllib
from pathlib import Path
from typing import Any

import pytest
import test_rig
from in_process import refused

from lmeasure.core import FileFormatError, LMeasureError
from lmeasure.io import Keys, Strict, checked, files
from lmeasure.io.models import MOST, Document, known_keys
from lmeasure.recording import read_counts, read_poses
from lmeasure.rig import Rig, read_rig

WEATHER, FROM = 'weather = "fine"', 'from = "B7"'


def lines_of(error: LMeasureError, path: Path) -> list[str]:
    return [line.removeprefix(str(path)) for line in error.lines]


def test_a_drum_that_is_missing_says_what_writes_it(tmp_path: Path) -> None:
    text = test_rig.RIG
    begin = text.index("[observation_point.drum]")
    (tmp_path / "rig.toml").write_text(text[:begin] + text[text.index("[[", begin) :])
    with pytest.raises(LMeasureError) as refused:
        read_rig(tmp_path / "rig.toml")
    (line,) = lines_of(refused.value, tmp_path / "rig.toml")
    assert line.endswith("[observation_point B1].drum: is missing: `lmeasure drum` writes it from what is measured (docs/drum.md)")


def test_all_complaints_of_a_rig_have_their_lines(tmp_path: Path) -> None:
    text = test_rig.RIG
    for old, new in (
        ('from = "B2"', FROM),
        ("groove_pitch_mm = -1.5", "groove_pich_mm = -1.5"),
        ("guide_alpha_deg = 47.0", "guide_alpha_deg = 147.0"),
        ("tangent_length_mm = 180.0", "tangent_length_mm = -3"),
        ('name = "demo"', f'name = "demo"\n{WEATHER}'),
        ("P2 = [100, 0, 0]", "P2 = [100, 0]"),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "rig.toml"
    path.write_text(text)
    number = {part: text.split("\n").index(part) + 1 for part in text.split("\n")}
    with pytest.raises(FileFormatError) as caught:
        read_rig(path)
    assert lines_of(caught.value, path) == [
        f":{number[WEATHER]}: weather: unknown key 'weather'. Known here: " + ", ".join(known_keys(Rig)),
        f":{number['guide_alpha_deg = 147.0']}: [observation_point B1].guide_alpha_deg: must be at most 90, is 147.0",
        f":{number['tangent_length_mm = -3']}: [observation_point B1].drum.tangent_length_mm: must be at least 0, is -3",
        f":{number['groove_pich_mm = -1.5']}: [observation_point B2].drum.groove_pich_mm: unknown key 'groove_pich_mm'. "
        "Did you mean 'groove_pitch_mm'?",
        f":{number['P2 = [100, 0]']}: tool.P2: number 3 is missing",
        f":{number[FROM]}: [cable c2].from: 'B7' is no observation_point (B1, B2)",
    ]
    assert str(caught.value).endswith(" (and 5 more)")
    assert "\n" not in str(caught.value)


def test_a_point_without_a_readable_name_is_complained_of_once(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(test_rig.RIG.replace('name = "B2"', 'name = { is = "B2" }', 1))
    with pytest.raises(FileFormatError) as caught:
        read_rig(path)
    assert [line.split(": ", 1)[1] for line in lines_of(caught.value, path)] == ["[observation_point 2].name: must be text"]


def test_the_command_prints_a_line_for_each(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(test_rig.RIG.replace("guide_alpha_deg = 47.0", "guide_alpha_deg = 147.0").replace("= [0, 100, 0]", '= "here"'))
    reported = refused("zone", path, "--out", tmp_path / "out.nc").splitlines()
    assert len(reported) > 1
    assert all(line.removeprefix("lmeasure: ").startswith(f"{path}:") for line in reported)
    assert not (tmp_path / "out.nc").exists()


def test_a_missing_key_is_at_its_table(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(test_rig.RIG.replace("count_length_mm = 0.02\n", ""))
    with pytest.raises(FileFormatError) as caught:
        read_rig(path)
    line = [i for i, text in enumerate(path.read_text().split("\n"), 1) if text == "[observation_point.drum]"][1]
    assert lines_of(caught.value, path) == [f":{line}: [observation_point B2].drum.count_length_mm: is missing"]


class Part(Strict):
    size: float


class Whole(Strict):
    part: tuple[Part, ...]


def test_of_very_many_complaints_the_first_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "parts.toml"
    path.write_text("".join(f"[[part]]\nsize = '{i}'\n" for i in range(70)))
    with pytest.raises(FileFormatError) as caught:
        checked(files.read_toml(path), Whole, str(path))
    reported = lines_of(caught.value, path)
    assert reported[:2] == [":2: [part 1].size: must be a number, is '0'", ":4: [part 2].size: must be a number, is '1'"]
    assert len(reported) == MOST + 1
    assert reported[-1] == f": and {70 - MOST} more"


LAYOUT = '''# a comment with = and [brackets]
schema = "x"   # [[not]] = a header

text = """
[false]
key = 1
"""
"quoted.key" = 'it'
a.b.c = 1
many = [
  [1, 2],   # ]
  [3, 4],
]
inline = { p = [1, 2], q.r = 2 }
[first]
value = 1
[first.inner]
deep = 2
[[several]]
name = "one"
[several.of]
x = 1
[[several]]
name = "two"
[[several.parts]]
y = 1
[[several.parts]]
y = 2
[[ spaced . out ]]
z = 1
'''
PLACES: dict[Keys, int] = {
    ("schema",): 2, ("text",): 4, ("quoted.key",): 8, ("a", "b", "c"): 9, ("many",): 10, ("many", 1, 0): 10, ("first",): 15,
    ("first", "value"): 16, ("first", "inner"): 17, ("first", "inner", "deep"): 18, ("several", 0): 19, ("several", 0, "name"): 20,
    ("several", 0, "of", "x"): 22, ("several", 1, "name"): 24, ("several", 1, "parts", 0, "y"): 26, ("several", 1, "parts", 1, "y"): 28,
    ("several", 1, "missing"): 23, ("spaced", "out", 0, "z"): 30,
}  # fmt: skip


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_lines_of_keys_however_they_are_written(end: str) -> None:
    text = LAYOUT.replace("\n", end)
    document = Document(tomllib.loads(text), text)
    assert {keys: document.line(keys) for keys in PLACES} == PLACES
    assert document.line(("inline", "p")) == 14
    assert document.line(("nowhere",)) is None


def every_key(value: Any, keys: Keys = ()) -> list[Keys]:
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [keys, *(inner for key, part in parts for inner in every_key(part, (*keys, key)))]


def test_every_key_of_a_shuffled_rig_is_on_its_line() -> None:
    """The line of a scalar is the one that holds its key; by a text search that knows nothing of the parser."""
    r = random.Random(5)
    for _ in range(20):
        head, *tables = test_rig.RIG.split("\n\n")
        text = "\n" * r.randrange(3) + "\n\n".join([head, *tables]).replace("\n", "\n" * r.randrange(1, 3) + "# [x]\n" * r.randrange(2))
        document = Document(tomllib.loads(text), text)
        lines = text.split("\n")
        for keys in every_key(dict(document)):
            line = document.line(keys)
            name = next((k for k in reversed(keys) if isinstance(k, str)), None)
            if name is not None:
                assert line is not None
                assert name in lines[line - 1], keys


def test_all_bad_cells_of_tables(tmp_path: Path) -> None:
    poses = tmp_path / "reference_poses.csv"
    poses.write_text("pose,x_mm,y_mm,z_mm,qx,qy,qz,qw,u_position_mm\n1,0,x,0,0,0,0,1,0.1\n2,0,0,,0,0,0,1,0.1\n3,0,0,0,0,0,0,1,little\n")
    with pytest.raises(FileFormatError) as caught:
        read_poses(poses, "puma-oat")
    assert lines_of(caught.value, poses) == [
        ":2: y_mm: must be a number, is 'x'",
        ":3: z_mm: is empty",
        ":4: u_position_mm: must be a number, is 'little'",
    ]
    counts = tmp_path / "pass1.csv"
    counts.write_text("time_s,ch1,ch2,sync\n0,1,2,0\n0.1,one,2,0\n0.2,1,nan,\n,1,,0\n")
    with pytest.raises(FileFormatError) as caught:
        read_counts(counts)
    assert lines_of(caught.value, counts) == [
        ":3: ch1: must be a number, is 'one'",
        ":4: sync: is empty",
        ":4: ch2: must be a finite number, is nan",
        ":5: time_s: is empty",
    ]
    counts.write_text("time_s,ch1,ch2\n0,1\n0.1,1,2\n0.2,1,2,3\n")
    with pytest.raises(FileFormatError) as caught:
        read_counts(counts)
    assert lines_of(caught.value, counts) == [":2: has 2 cells, the first line 3: '0,1'", ":4: has 4 cells, the first line 3: '0.2,1,2,3'"]
    counts.write_text("time_s,ch1\n" + "".join(f"{i},x\n" for i in range(5000)))
    with pytest.raises(FileFormatError) as caught:
        read_counts(counts)
    assert len(caught.value.lines) == MOST + 1
