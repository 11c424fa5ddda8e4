"""rig.toml: what it means, that it comes back, and one line for everything that is wrong with it."""

import copy
import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lmeasure.core import FileFormatError, RigError
from lmeasure.rig import Rig, read_rig, rig_from_dict, write_rig

RIG = (Path(__file__).parent / "inputs" / "rig.toml").read_text(encoding="utf-8")


def data() -> dict[str, Any]:
    return tomllib.loads(RIG)


def six() -> dict[str, Any]:
    """The rig with six cables, two to each attachment point."""
    out = data()
    out["cable"] = [
        {"name": f"c{i}", "channel": f"ch{i % 2}", "from": f"B{i % 2 + 1}", "to": f"P{i // 2 + 1}", "pass": i // 2 + 1} for i in range(6)
    ]
    return out


def test_a_rig_comes_back_from_its_file(tmp_path: Path) -> None:
    rig = rig_from_dict(data())
    write_rig(tmp_path / "rig.toml", rig)
    assert read_rig(tmp_path / "rig.toml") == rig
    text = (tmp_path / "rig.toml").read_text(encoding="utf-8")
    assert 'from = "B1"' in text
    assert "calibration" not in text
    assert read_rig(tmp_path / "rig.toml").to_dict() == rig.to_dict()


def test_a_limit_that_nobody_stated_is_not_stated_by_the_file() -> None:
    """Of drums and of encoders: what is written is what was stated, so that the motion tells of the others after a round too."""
    given = data()
    given["observation_point"][0]["drum"]["max_cable_speed_mm_s"] = 700.0
    given["swivel"] = [{"point": f"B{i}", "channel": f"sw{i}", "counts_per_revolution": 4096} for i in (1, 2)]
    given["swivel"][1]["max_speed_deg_s"] = 90.0
    for _ in range(2):
        rig = rig_from_dict(given)
        drums, swivels = [p.drum for p in rig.observation_point], list(rig.swivel)
        assert [d.rate_stated for d in drums] == [True, False]
        assert [s.rate_stated for s in swivels] == [False, True]
        given = rig.to_dict()
        assert [p["drum"].get("max_cable_speed_mm_s") for p in given["observation_point"]] == [700.0, None]
        assert [s.get("max_speed_deg_s") for s in given["swivel"]] == [None, 90.0]
    # of what a rig may have, encoders alone are no key where there are none
    plain = rig_from_dict(data() | {"assumed": []}).to_dict()
    assert plain["assumed"] == []
    assert not {"swivel", "joint_encoder"} & set(plain)


def test_every_double_comes_back(tmp_path: Path) -> None:
    d = data()
    for value in (0.1, 1 / 3, 5e-324, 1e-17, 123456.78901234567, math.pi):
        d["observation_point"][0]["position_mm"] = [value, -value, 0.0]
        write_rig(tmp_path / "rig.toml", rig_from_dict(d))
        assert read_rig(tmp_path / "rig.toml").point("B1").position_mm == (value, -value, 0.0)


def test_defaults_are_those_of_the_contract() -> None:
    rig = rig_from_dict(data())
    drum = rig.point("B1").drum
    assert (drum.count_sign, drum.scale, drum.max_cable_speed_mm_s) == (1, 1.0, 20000.0)
    assert rig.point("B2").drum.counter_bits is None
    assert rig.angles == "puma-oat"
    assert [c.passage for c in rig.cable] == [1, 1, 2]
    assert rig.passes == 2
    assert [c.name for c in rig.cables_of(2)] == ["c3"]


def test_rows_of_the_kernels() -> None:
    rows = rig_from_dict(data()).cable_rows()
    assert rows.shape == (3, 20)
    a, b = math.radians(47), math.radians(183)
    assert rows[0, :3].tolist() == [159.05, -1642.2, 1381.81]
    # the way from B to the fixed pulley points down by alpha and from +Y by beta towards +X; the cable comes the other way
    way = [math.cos(a) * math.sin(b), math.cos(a) * math.cos(b), -math.sin(a)]
    assert rows[0, 3:6] == pytest.approx([-x for x in way], abs=1e-15)
    assert np.linalg.norm(rows[:, 3:6], axis=1) == pytest.approx(np.ones(3), abs=1e-15)
    assert rows[1, 6:17].tolist() == [0, 100, 0, 0, 0, -25, -1.5 / 4096, 0.02, math.radians(30), math.radians(-10), 4096]
    assert not rows[:, 17:].any()
    assert rig_from_dict(data()).scales().tolist() == [1, 0.5, 1]


def test_whole_floats_are_whole_numbers() -> None:
    d = data()
    d["observation_point"][0]["drum"]["counts_per_revolution"] = 6000.0
    assert rig_from_dict(d).point("B1").drum.counts_per_revolution == 6000


def put(*path: Any) -> Callable[[dict[str, Any]], None]:
    """Set the value at the end of a path of keys."""

    def change(d: Any) -> None:
        *steps, key, value = path
        for step in steps:
            d = d[step]
        d[key] = value

    return change


def drop(*path: Any) -> Callable[[dict[str, Any]], None]:
    def change(d: Any) -> None:
        for step in path[:-1]:
            d = d[step]
        del d[path[-1]]

    return change


B2 = ("observation_point", 1)
REFUSALS: list[tuple[Callable[[dict[str, Any]], None], str]] = [
    (put("foo", 1), "unknown key 'foo'"),
    (put(*B2, "position_m", [1, 2, 3]), "unknown key 'position_m'. The unit is part of the name: 'position_mm'"),
    (put(*B2, "guide_alpha_rad", 1), "unknown key 'guide_alpha_rad'. The unit is part of the name: 'guide_alpha_deg'"),
    (
        put(*B2, "drum", "groove_pich_mm", 1),
        "[observation_point B2].drum.groove_pich_mm: unknown key 'groove_pich_mm'. Did you mean 'groove_pitch_mm'?",
    ),
    (put("cable", 0, "from_point", "B1"), "[cable c1].from_point: unknown key 'from_point'"),
    (put(*B2, "pulley_radius_mm", "12"), "[observation_point B2].pulley_radius_mm: must be a number, is '12'"),
    (put(*B2, "pulley_radius_mm", True), "[observation_point B2].pulley_radius_mm: must be a number, is true"),
    (put(*B2, "pulley_radius_mm", math.nan), "[observation_point B2].pulley_radius_mm: must be a finite number"),
    (put(*B2, "pulley_radius_mm", -1), "[observation_point B2].pulley_radius_mm: must be at least 0, is -1"),
    (put(*B2, "pulley_radius_mm", 1e300), "[observation_point B2].pulley_radius_mm: must be a length of at most 1000000 mm"),
    (put(*B2, "guide_alpha_deg", math.inf), "[observation_point B2].guide_alpha_deg: must be a finite number"),
    (put(*B2, "guide_alpha_deg", 91), "[observation_point B2].guide_alpha_deg: must be at most 90"),
    (put(*B2, "position_mm", [1, 2]), "[observation_point B2].position_mm: number 3 is missing"),
    (put(*B2, "position_mm", [1, 2, 3, 4]), "[observation_point B2].position_mm: must have at most 3 of them, has 4"),
    (put(*B2, "position_mm", [1, 2, "3"]), "[observation_point B2].position_mm: number 3 must be a number, is '3'"),
    (put(*B2, "position_mm", [[1], 2, 3]), "[observation_point B2].position_mm: number 1 must be a number"),
    (put(*B2, "position_mm", {"x": 1}), "[observation_point B2].position_mm: must be an array"),
    (put(*B2, "drum", 5), "[observation_point B2].drum: must be"),
    (put(*B2, "drum", "counts_per_revolution", 6000.5), "drum.counts_per_revolution: must be a whole number, is 6000.5"),
    (put(*B2, "drum", "counts_per_revolution", True), "drum.counts_per_revolution: must be a whole number, is true"),
    (put(*B2, "drum", "counts_per_revolution", 10**400), "drum.counts_per_revolution: must be at most"),
    (put(*B2, "drum", "count_length_mm", 10**400), "drum.count_length_mm: must be a number"),
    (put(*B2, "drum", "count_length_mm", 0), "drum.count_length_mm: must be positive"),
    (put(*B2, "drum", "groove_pitch_mm", 82), "drum.groove_pitch_mm: must be less than the cable of one turn, 81.92 mm"),
    (put(*B2, "drum", "count_sign", True), "drum.count_sign: must be a whole number, is true"),
    (put(*B2, "drum", "count_sign", 2), "drum.count_sign: must be 1 or -1"),
    (put(*B2, "drum", "scale", 0), "drum.scale: must be positive"),
    (put(*B2, "drum", "counter_bits", 7), "drum.counter_bits: must be at least 8"),
    (put(*B2, "drum", "max_cable_speed_mm_s", -1), "drum.max_cable_speed_mm_s: must be positive"),
    (put(*B2, "u_position_mm", -1), "[observation_point B2].u_position_mm: must be at least 0"),
    (drop(*B2, "drum"), "[observation_point B2].drum: is missing"),
    (drop(*B2, "position_mm"), "[observation_point B2].position_mm: is missing"),
    (drop("cable", 0, "from"), "[cable c1].from: is missing"),
    (drop("tool"), "tool: is missing"),
    (drop("schema"), "schema: is missing"),
    (drop("name"), "name: is missing"),
    (put("schema", "lmeasure.rig/2"), "schema: must be 'lmeasure.rig/1', is 'lmeasure.rig/2'"),
    (put("name", ""), "name: must not be empty"),
    (put("name", "a\nb"), "name: must be one line of printable text"),
    (put("name", 5), "name: must be text, is 5"),
    (put("angles", "euler"), "angles: 'euler' is not one of puma-oat"),
    (put("assumed", ["B1.pulley_radius"]), "assumed: 'B1.pulley_radius' names no value of this rig. Did you mean 'B1.pulley_radius_mm'?"),
    (put("assumed", "B1"), "assumed: must be an array"),
    (put("cable", []), "cable: must not be empty"),
    (put("tool", {}), "tool: must not be empty"),
    (put("tool", "P1", [1, 2]), "tool.P1"),
    (put("tool", "P 1", [1, 2, 3]), "tool.P 1"),
    (put("observation_point", {"name": "B1"}), "observation_point: must be an array"),
    (put("cable", 0, "from", "B9"), "[cable c1].from: 'B9' is no observation_point (B1, B2)"),
    (put("cable", 0, "to", "P9"), "[cable c1].to: 'P9' is no point of [tool] (P1, P2, P3)"),
    (put("cable", 0, "channel", "ch2"), "[cable c2].channel: 'ch2' serves another cable too in pass 1"),
    (put("cable", 0, "channel", "sync"), "[cable c1].channel: 'sync' is the name of another column"),
    (put("cable", 0, "channel", ""), "[cable c1].channel: must not be empty"),
    (put("cable", 0, "name", "c2"), "[cable 2].name: the name 'c2' is given 2 times"),
    (put(*B2, "name", "B1"), "[observation_point 2].name: the name 'B1' is given 2 times"),
    (put("cable", 2, "pass", 3), "cable: the passes are [1, 3]. They must be numbered from 1 without a hole"),
    (put("cable", 2, "pass", 0), "[cable c3].pass: must be at least 1"),
    (put("cable", 2, "pass", True), "[cable c3].pass: must be a whole number"),
    (put("cable", 2, "pass", "2"), "[cable c3].pass: must be a whole number, is '2'"),
]


@pytest.mark.parametrize(("change", "line"), REFUSALS, ids=[line[:50] for _, line in REFUSALS])
def test_one_line_names_the_key(change: Callable[[dict[str, Any]], None], line: str) -> None:
    d = copy.deepcopy(data())
    change(d)
    with pytest.raises(RigError) as caught:
        rig_from_dict(d, "some/rig.toml")
    text = str(caught.value)
    assert text.startswith("some/rig.toml: ")
    assert line in text
    assert "\n" not in text


def test_a_pose_needs_six_cables() -> None:
    with pytest.raises(RigError, match=r"rig 'demo': has 3 cables. A pose is reconstructed from exactly 6"):
        rig_from_dict(data()).require_pose()
    rig_from_dict(six()).require_pose()


@pytest.mark.parametrize(
    "tool",
    [
        {"P1": [0, 0, 0], "P2": [1, 2, 3], "P3": [-2, -4, -6]},
        {"P1": [5, 5, 5], "P2": [5, 5, 5], "P3": [80, 0, 0]},
        {"P1": [0, 0, 0], "P2": [100, 0, 0], "P3": [50, 1e-7, 0]},
    ],
)
def test_attachment_points_on_one_line_tell_no_orientation(tool: dict[str, Any]) -> None:
    rig = rig_from_dict(six() | {"tool": tool})
    with pytest.raises(RigError, match=r"tool: all cables end at P1, P2, P3. To measure the orientation, they must end at three points"):
        rig.require_pose()


def test_a_name_contains_no_quotation_mark() -> None:
    """Names are headers of tables."""
    data = six()
    data["cable"][0]["channel"] = 'c"1'
    with pytest.raises(RigError, match="channel") as raised:
        rig_from_dict(data)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", "schema: is missing"),
        (b"\xff\xfe", "is not UTF-8 text (byte 0). Save it as UTF-8"),
        (RIG.replace("47.0", "47,5").encode(), ". Write numbers with a decimal point: 47.5"),
        (RIG.replace('"B1"', '"B1').encode(), ". A text ends with a quotation mark on its line"),
        (b"name = ", "is not TOML"),
        (b"x = " + b"9" * 5000, "is not TOML"),
        (b"a = " + b"[" * 100_000, "is not TOML"),
        (RIG.replace("[tool]", "[tool]\nP1 = [0, 0, 0]").encode(), "is not TOML"),
        (RIG.replace("47.0", "1979-05-27").encode(), "guide_alpha_deg: must be a number"),
    ],
)
def test_what_is_no_rig_file(tmp_path: Path, content: bytes, line: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_bytes(content)
    with pytest.raises(FileFormatError) as caught:
        read_rig(path)
    assert str(caught.value).startswith(str(path))
    assert line in str(caught.value)


def test_of_another_kind_of_file_that_alone_is_said(tmp_path: Path) -> None:
    path = tmp_path / "drums.toml"
    path.write_text('# of a cell\nschema = "lmeasure.drum/1"\n[[drum]]\npoint = "B1"\n')
    with pytest.raises(FileFormatError) as caught:
        read_rig(path)
    assert caught.value.lines == (f"{path}:2: schema: must be 'lmeasure.rig/1', is 'lmeasure.drum/1'",)


def test_crlf_is_read_and_no_file_is_said(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    for mark in (b"", b"\xef\xbb\xbf"):
        path.write_bytes(mark + RIG.replace("\n", "\r\n").encode())
        assert read_rig(path) == rig_from_dict(data())
    with pytest.raises(FileFormatError, match=r"other.toml: cannot be read: No such file"):
        read_rig(tmp_path / "other.toml")
    with pytest.raises(FileFormatError, match=r"cannot be read"):
        read_rig(Path("a\0b"))


def test_rigs_are_frozen() -> None:
    rig = rig_from_dict(data())
    with pytest.raises(ValueError, match="frozen"):
        rig.name = "other"
    assert isinstance(rig, Rig)
