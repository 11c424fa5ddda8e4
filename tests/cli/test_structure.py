"""`lmeasure structure`: what it writes, and what it refuses in one line."""

import json
from pathlib import Path

import pytest

from lmeasure.cli import main

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"
BASE = {"B1": (1, 5, 0), "B2": (3, 3, 0), "B3": (4, 2, 0), "B4": (1, 1, 0)}
PLATFORM = {"P1": (0, 0, 0), "P2": (1, 2, 0), "P3": (-2, 2, 0), "P4": (0, 4, 0)}
LINKS = [("B2", "P1", 10.0), ("B3", "P1", 10.5), ("B4", "P1", 11.0), ("B1", "P4", 8.9), ("B1", "P3", 7.98), ("B3", "P2", 9.9)]


def text(links: list[tuple[str, str, float]], lengths: bool = True) -> str:
    """A structure file of the thesis' example."""
    points = [
        f"[{side}]\n" + "".join(f"{n} = {list(map(float, p))}\n" for n, p in of.items())
        for side, of in (("base", BASE), ("platform", PLATFORM))
    ]
    each = [f'[[link]]\nfrom = "{b}"\nto = "{p}"\n' + (f"length_mm = {length}\n" if lengths else "") for b, p, length in links]
    return "\n".join(['schema = "lmeasure.structure/1"', *points, *each])


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):  # type: ignore[no-untyped-def]
    """The command in a folder of its own: exit code, output, errors."""
    monkeypatch.chdir(tmp_path)

    def command(*words: str) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["lmeasure", "structure", *words])
        with pytest.raises(SystemExit) as end:
            main()
        printed = capsys.readouterr()
        return int(end.value.code or 0), printed.out, printed.err

    return command


def test_the_example_of_4_1_is_written(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "s.toml").write_text(text(LINKS))
    code, out, _ = run("s.toml", "--out", "s.json", "--position-mm", "2.5625,6.6875,9.285", "--quaternion", "0,0,0,1")
    assert code == 0
    record = json.loads((tmp_path / "s.json").read_text())
    assert (record["class"], record["freedoms"], record["closed_form"], record["complex_assemblies"]) == ("L-3111-2211", 6, True, 8)
    assert (record["degenerate"], record["architecturally_singular"], record["status"]) == (False, False, "all accounted for")
    assert len(record["assemblies"]) == 8
    assert all(one["certified"] for one in record["assemblies"])
    assert (record["rank"], len(record["gradient"]), len(record["pressure_angles_deg"])) == (6, 6, 6)
    assert "8 real assemblies, 8 with complex ones of 8: all accounted for" in out


def test_without_lengths_or_a_pose_only_the_structure_is_told(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "s.toml").write_text(text(LINKS, lengths=False))
    assert run("s.toml", "--out", "s.json")[0] == 0
    assert not {"assemblies", "status", "determinant"} & set(json.loads((tmp_path / "s.json").read_text()))


def test_a_singular_pose_has_its_measures(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """The three columns of 4.5: the gradient is (0, 0, 6.5; 0, 0, 0)."""
    base = {"B1": (0, -1, -1.6), "B2": (1, 0, -1.6), "B3": (0, 1, -1.6), "B4": (0, -2.6, 0), "B5": (2.6, 0, 0), "B6": (0, 2.6, 0)}
    points = "[base]\n" + "".join(f"{n} = {list(map(float, p))}\n" for n, p in base.items())
    points += "[platform]\nP1 = [0.0, -1.0, 0.0]\nP2 = [1.0, 0.0, 0.0]\nP3 = [0.0, 1.0, 0.0]\n"
    links = "".join(f'[[link]]\nfrom = "B{i + 1}"\nto = "P{i % 3 + 1}"\n' for i in range(6))
    (tmp_path / "s.toml").write_text('schema = "lmeasure.structure/1"\n' + points + links)
    assert run("s.toml", "--out", "s.json", "--position-mm", "0,0,0")[0] == 0
    record = json.loads((tmp_path / "s.json").read_text())
    assert (record["class"], record["rank"], record["condition"]) == ("L-222-111111", 5, None)
    assert record["gradient"] == pytest.approx([0, 0, 6.5, 0, 0, 0], abs=1e-12)
    assert record["determinant"] == pytest.approx(0.0, abs=1e-12)


def test_a_rig_is_read_as_straight_links(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    assert run(str(TRUTH / "cell-run" / "rig.toml"), "--out", "s.json")[0] == 0
    assert json.loads((tmp_path / "s.json").read_text())["class"] == "L-222-111111"


def test_the_list_has_every_structure(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    code, out, _ = run("--list", "--out", "l.json")
    every = json.loads((tmp_path / "l.json").read_text())
    assert (code, len(every), len(out.splitlines())) == (0, 60, 60)
    assert all({"notation", "class", "closed_form", "complex_assemblies", "degenerate"} <= set(s) for s in every)
    assert [s["notation"] for s in every if s["degenerate"]] == ["L-3111-3111:bcd-a-a-a"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.replace('from = "B2"', 'from = "B7"'), "s.toml: link 1: the base has no point 'B7'; it has B1, B2, B3, B4"),
        (lambda t: t.replace("length_mm = 10.5\n", ""), "s.toml: link 2: length_mm is missing; all links have it or none"),
        (lambda t: t.replace("length_mm = 10.5", "length_mm = -1.0"), "length_mm: must be positive"),
        (lambda t: t[: t.rindex("[[link]]")], "s.toml: has 5 links; structures are of 6"),
        (lambda t: t.replace("length_mm = 10.5", "length = 10.5"), "unknown key 'length'"),
        (lambda t: t.replace("structure/1", "structure/9"), "schema: must be 'lmeasure.structure/1'"),
        (lambda t: "x = ", "s.toml"),
    ],
)
def test_a_file_that_is_wrong_is_one_line(run, tmp_path: Path, change, words: str) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "s.toml").write_text(change(text(LINKS)))
    code, _, err = run("s.toml", "--out", "s.json")
    assert (code, err.count("\n")) == (1, 1)
    assert words in err
    assert not (tmp_path / "s.json").exists()


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["s.toml", "--list"],
        ["--list", "--position-mm", "0,0,0"],
        ["s.toml", "--quaternion", "0,0,0,1"],
        ["s.toml", "--position-mm", "1,2"],
    ],
)
def test_wrong_use_has_exit_code_2(run, tmp_path: Path, words: list[str]) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "s.toml").write_text(text(LINKS))
    assert run(*words)[0] == 2


def test_a_pose_that_is_none_is_refused(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "s.toml").write_text(text(LINKS))
    assert run("s.toml", "--position-mm", "0,0,0", "--quaternion", "0,0,0,2")[0] == 2
    code, _, said = run("s.toml", "--position-mm", "3,3,0")
    assert (code, "a link has no length at this pose" in said) == (1, True)


def test_a_rig_that_is_singular_everywhere_has_no_assemblies(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """Similar regular hexagons: lengths fit a whole motion, or nothing."""
    corners = [(2, 0), (1, 2), (-1, 2), (-2, 0), (-1, -2), (1, -2)]
    points = []
    for side, size in (("base", 300.0), ("platform", 100.0)):
        points.append(
            f"[{side}]\n" + "".join(f"{side[0]}{i} = {[size * x, size * y * 0.75**0.5, 0.0]}\n" for i, (x, y) in enumerate(corners))
        )
    links = "".join(f'[[link]]\nfrom = "b{i}"\nto = "p{i}"\nlength_mm = 700.0\n' for i in range(6))
    (tmp_path / "s.toml").write_text('schema = "lmeasure.structure/1"\n' + "".join(points) + links)
    code, out, _ = run("s.toml", "--out", "s.json")
    record = json.loads((tmp_path / "s.json").read_text())
    assert (code, record["architecturally_singular"], record["degenerate"]) == (0, True, False)
    assert (record["assemblies"], record["status"]) == ([], "not proved")
    assert "singular at every pose: base and platform are similar plane figures on conics" in out
