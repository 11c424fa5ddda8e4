"""A log reconstructed in pieces, from file to file, is the log reconstructed at once."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cells import FloatArray, cell, motion, record, with_recorded

from lmeasure.core import FileFormatError
from lmeasure.io import tables
from lmeasure.recording import Run, read_run, read_run_head, write_run
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.trajectory import can_stream, reconstruct, reconstruct_stream, write_trajectory

N = 3000


@pytest.fixture(autouse=True)
def _small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "PIECE_ROWS", 257)
    monkeypatch.setattr(tables, "PIECE_BYTES", 10_000)


def difficult(rig: Rig, reach_mm: float = 520.0) -> Run:
    """Gaps, a jump that comes back too late to be nothing, one that does not: across the pieces' ends."""
    run = record(rig, *motion(N, reach_mm=reach_mm, tilt_rad=0.1))
    recorded: FloatArray = run.passes[0].recorded.copy()
    recorded[250:600, 2] = np.nan
    recorded[700:1300, 4] += 9000.0
    recorded[1500, 1] = np.nan
    recorded[2800:, 3] -= 9000.0
    return with_recorded(run, recorded)


def assert_alike(a: Path, b: Path) -> None:
    """The same trajectory to 1e-9 mm; how many steps a sample took depends on where it was started."""
    read = pd.read_csv if a.suffix == ".csv" else pd.read_parquet
    left, right = (read(path).drop(columns="iterations") for path in (a, b))
    pd.testing.assert_frame_equal(left, right, rtol=1e-7, atol=1e-9)


def assert_same_text(pieces: str, whole: str) -> None:
    """Word for word, but for what is taken as exact: its sizes are the largest over samples, and pieces look at others."""
    number = re.compile(r"(?<= )\d+(?:\.\d+)?(?=,|$)")
    for a, b in zip(pieces.splitlines(), whole.splitlines(), strict=True):
        if a.startswith("taken as exact"):
            assert number.sub("#", a) == number.sub("#", b)
            assert [float(x) for x in number.findall(a)] == pytest.approx([float(x) for x in number.findall(b)], rel=0.2)
        else:
            assert a == b


@pytest.mark.parametrize(("kind", "bits"), [(".csv", 32), (".parquet", None)])
def test_pieces_give_the_same_file(kind: str, bits: int | None, tmp_path: Path) -> None:
    write_run(tmp_path / "run", difficult(cell(bits)), suffix=kind)
    head = read_run_head(tmp_path / "run")
    assert can_stream(head)
    done: list[int] = []
    summary = reconstruct_stream(head, tmp_path / "pieces.parquet", progress=lambda part, _: done.append(part))
    whole = reconstruct(read_run(tmp_path / "run"))
    write_trajectory(tmp_path / "whole.parquet", whole)
    assert len(done) > 5
    assert done == sorted(done)
    assert done[-1] == 100
    assert_alike(tmp_path / "pieces.parquet", tmp_path / "whole.parquet")
    assert_same_text(summary.text(), whole.summary())
    assert {"ok", "gap", "jump", "origin_lost"} == set(pd.read_parquet(tmp_path / "pieces.parquet")["status"])


@pytest.mark.parametrize("kind", [".parquet"])
def test_a_width_that_is_not_stated_is_found_in_the_whole_file_first(kind: str, tmp_path: Path) -> None:
    run = record(cell(16), *motion(N, reach_mm=520.0, tilt_rad=0.1))
    assert (np.abs(np.diff(run.passes[0].recorded, axis=0)) > 60_000).any()
    write_run(tmp_path / "run", Run(cell(None), run.start, run.passes, unstated="exact"), suffix=kind)
    summary = reconstruct_stream(read_run_head(tmp_path / "run"), tmp_path / "pieces.csv")
    whole = reconstruct(read_run(tmp_path / "run"))
    write_trajectory(tmp_path / "whole.csv", whole)
    assert_alike(tmp_path / "pieces.csv", tmp_path / "whole.csv")
    assert any("16 bits" in note for note in map(str, summary.notes))
    assert sorted(map(str, summary.notes)) == sorted(map(str, whole.notes))


def test_a_speed_that_is_not_stated_is_taken_from_the_whole_file(tmp_path: Path) -> None:
    """A pause that 20 m/s would fill with a whole range, and the motion's own speed does not."""
    data = cell(16).to_dict()
    for point in data["observation_point"]:
        point["drum"].pop("max_cable_speed_mm_s", None)
    rig, times = rig_from_dict(data), motion(N, reach_mm=520.0, tilt_rad=0.1)
    run = record(rig, *times)
    late = replace(run.passes[0], time_s=run.passes[0].time_s + 0.03 * (np.arange(N) > 600))
    write_run(tmp_path / "run", replace(run, passes=(late,)))
    summary = reconstruct_stream(read_run_head(tmp_path / "run"), tmp_path / "pieces.csv")
    whole = reconstruct(read_run(tmp_path / "run"))
    write_trajectory(tmp_path / "whole.csv", whole)
    assert_alike(tmp_path / "pieces.csv", tmp_path / "whole.csv")
    assert (whole.status == 0).all()
    assert any("max_cable_speed_mm_s of ch1, ch2, ch3, ch4, ch5, ch6 is not stated" in note for note in map(str, summary.notes))
    assert sorted(map(str, summary.notes)) == sorted(map(str, whole.notes))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("\n2.5,", "\n2.5,x", ":2502: ch1: must be"),
        ("\n2.5,", "\n2.5,nan,", ":2502: ch1: must be"),
        ("\n2.5,", "\n0.5,", "sample 2500"),
        ("\n2.5,", "\n2.5,1,2,3,", "pass1.csv"),
    ],
)
def test_what_is_wrong_late_in_a_file_is_said_with_its_place_and_leaves_nothing(old: str, new: str, said: str, tmp_path: Path) -> None:
    write_run(tmp_path / "run", record(cell(), *motion(N)))
    path = tmp_path / "run" / "pass1.csv"
    text = path.read_text()
    if new.endswith("nan,"):  # in the place of the first count
        old = text[text.index(old) : text.index(",", text.index(old) + len(old)) + 1]
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(FileFormatError, match=said):
        reconstruct_stream(read_run_head(tmp_path / "run"), tmp_path / "out" / "a.csv")
    assert list(tmp_path.glob("out/*")) == []


def test_blanks_around_a_number_are_read_as_at_once(tmp_path: Path) -> None:
    write_run(tmp_path / "run", record(cell(), *motion(N)))
    path = tmp_path / "run" / "pass1.csv"
    lines = path.read_text().split("\n")
    lines[2001] = ", ".join(lines[2001].split(","))
    path.write_text("\n".join(lines))
    reconstruct_stream(read_run_head(tmp_path / "run"), tmp_path / "a.parquet")
    write_trajectory(tmp_path / "b.parquet", reconstruct(read_run(tmp_path / "run")))
    assert_alike(tmp_path / "a.parquet", tmp_path / "b.parquet")


def test_two_passes_do_not_stream(tmp_path: Path) -> None:
    data = cell().to_dict()
    for i, c in enumerate(data["cable"]):
        c["channel"], c["pass"] = f"ch{i % 3 + 1}", i // 3 + 1
    write_run(tmp_path / "run", record(cell(cable=data["cable"]), *motion(10)))
    assert not can_stream(read_run_head(tmp_path / "run"))
