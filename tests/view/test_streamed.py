"""A run that goes into a recording piece by piece is the run that goes in whole."""

import itertools
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, strategies as st
from in_process import ran
from rerun.chunk import RrdReader

from lmeasure.core import FileFormatError
from lmeasure.io import tables
from lmeasure.recording import Counts, Run, read_run, read_run_head, write_run
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.sensors import Lengths
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path
from lmeasure.trajectory import Trajectory, reconstruct, reconstruct_stream
from lmeasure.view import recording, stages, streamed_recording, write_recording
from lmeasure.view.recording import Thinned

N = 1500
PIECE = 128
HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
PLACE = np.array([120.0, -80.0, 60.0, 0.0, 0.0, 0.0, 1.0])


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "PIECE_ROWS", PIECE)
    for module in (recording, stages):
        monkeypatch.setattr(module, "MAX_FRAMES", 200)
        monkeypatch.setattr(module, "MAX_PATH_POINTS", 400)


def spoiled(rig: Rig, gap: slice = slice(250, 600)) -> Run:
    """A run with a gap over pieces' ends and a jump that comes back."""
    time_s, poses = smooth_path(HOME, [Leg(PLACE, 300.0, 1.0), Leg(HOME, 300.0, 1.0)] * 3, 1000.0)
    run = simulate_run(rig, time_s[:N], poses[:N], noise_mm=0.0, rng=np.random.default_rng(3)).run
    recorded = run.passes[0].recorded
    recorded[gap, 2] = np.nan
    recorded[900:1100, 1] += 3000.0
    return run


def cells(path: Path) -> dict[tuple[str, str], list[tuple[int, Any]]]:
    """What a recording holds by entity and component, at each sample; at -1 what holds at all times."""
    out: dict[tuple[str, str], list[tuple[int, Any]]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        names = batch.schema.names
        at = np.asarray(batch.column("sample").cast(pa.int64())).tolist() if "sample" in names else [-1] * len(batch)
        for name in names:
            if ":" in name:
                out.setdefault((str(chunk.entity_path), name), []).extend(zip(at, batch.column(name).to_pylist(), strict=True))
    return {key: sorted(values, key=lambda cell: cell[0]) for key, values in out.items()}


NOT_THE_SAME = ("/__properties", "/world/cables", "/world/pulleys", "/world/tangent_points", "/world/platform", "/world/path", "/notes")


def scheme(kind: str) -> Rig:
    data = cell_rig(3).to_dict()
    for point in data["observation_point"]:
        point["drum"]["counter_bits"] = 14 if kind == "wraps" else 32
    if kind == "point":
        for c in data["cable"]:
            c["to"] = "P1"
        data["cable"] = data["cable"][:4]
    return rig_from_dict(data)


@pytest.mark.parametrize("kind", ["point", "from the start", "wraps"])
def test_pieces_give_the_recording_of_the_whole(kind: str, tmp_path: Path) -> None:
    # from the start: the first piece knows no pose; a counter of few bits would be lost in a gap
    gap = {"from the start": slice(0, 300), "wraps": slice(0, 0)}.get(kind, slice(250, 600))
    write_run(tmp_path / "run", spoiled(scheme(kind), gap), suffix=".parquet")
    head, run = read_run_head(tmp_path / "run"), read_run(tmp_path / "run")
    with streamed_recording(tmp_path / "pieces.rrd", head) as each:
        reconstruct_stream(head, tmp_path / "pieces.parquet", each=each)
    write_recording(tmp_path / "whole.rrd", run.rig, run=run, trajectory=reconstruct(run))
    pieces, whole = cells(tmp_path / "pieces.rrd"), cells(tmp_path / "whole.rrd")
    assert kind != "wraps" or (np.abs(np.diff(run.passes[0].recorded, axis=0)) > 16_000).any()
    assert pieces.keys() == whole.keys()
    for key, expected in whole.items():
        if key[0].startswith(NOT_THE_SAME):
            continue
        found = pieces[key]
        assert [(at, value and len(value)) for at, value in found] == [(at, value and len(value)) for at, value in expected], key
        values, others = ([value for _, value in side if value] for side in (found, expected))
        if values and isinstance(values[0][0], float | list):
            np.testing.assert_allclose(values, others, rtol=1e-6, atol=1e-7, err_msg=str(key))
        else:
            assert values == others, key
    assert len(pieces["/status", "TextLog:text"]) >= 3
    known = [at for at, value in pieces["/world/tool", "Points3D:positions" if kind == "point" else "Transform3D:translation"] if value]
    # the jump that comes back late is a lost origin
    assert len(known) > N / 3
    assert len(pieces["/residual_mm/c1", "Scalars:scalars"]) == N


def test_pictures_of_pieces_are_as_many_and_true(tmp_path: Path) -> None:
    write_run(tmp_path / "run", spoiled(scheme("six")), suffix=".parquet")
    head = read_run_head(tmp_path / "run")
    kept: list[Trajectory] = []
    with streamed_recording(tmp_path / "pieces.rrd", head) as each:

        def also(counts: Counts, lengths: Lengths, piece: Trajectory) -> None:
            kept.append(piece)
            each(counts, lengths, piece)

        reconstruct_stream(head, tmp_path / "pieces.parquet", each=also)
    found = cells(tmp_path / "pieces.rrd")
    poses, status = (np.concatenate([getattr(piece, name) for piece in kept]) for name in ("poses", "status"))
    frames = dict(found["/world/cables/c3", "LineStrips3D:strips"])
    changes = {0, *(np.flatnonzero(np.diff(status)) + 1).tolist(), N - 1}
    assert len(changes) >= 4
    assert changes <= frames.keys()
    assert 150 <= len(frames) <= 2 * 200 + len(changes)
    assert {at for at, strip in frames.items() if not strip} == {at for at in frames if np.isnan(poses[at, 0])}
    ends = recording.metres(poses[:, :3])
    (_, strips) = found["/world/path", "LineStrips3D:strips"][0]
    points = np.concatenate([np.array(strip, dtype=np.float32) for strip in strips])
    # a strip for each colour of its 95 % radius, which begins where the one before it ended
    broken = [i for i, (a, b) in enumerate(itertools.pairwise(strips)) if a[-1] != b[0]]
    assert 200 <= len(points) - (len(strips) - 1 - len(broken)) <= 2 * 400 + len(changes)
    assert len(set(found["/world/path", "LineStrips3D:colors"][0][1])) > 4
    where = {tuple(p) for p in ends[np.isfinite(poses[:, 0])].tolist()}
    assert all(tuple(p) in where for p in points.tolist())
    # no line goes over what is not known
    assert len(broken) == int((np.diff((status == 0).astype(int)) == 1).sum())
    notes = found["/notes", "TextDocument:text"][0][1][0]
    assert f"drawn at {len(frames)} of {N} samples" in notes
    assert f"of {N} samples" in notes.split("/world/path", 1)[1]


def test_pieces_are_let_go(tmp_path: Path) -> None:
    write_run(tmp_path / "run", spoiled(scheme("six")), suffix=".parquet")
    head = read_run_head(tmp_path / "run")
    alive: list[weakref.ref[Any]] = []
    most = 0
    with streamed_recording(tmp_path / "pieces.rrd", head) as each:

        def watched(counts: Counts, lengths: Lengths, piece: Trajectory) -> None:
            nonlocal most
            each(counts, lengths, piece)
            alive.append(weakref.ref(piece.systematic))
            alive.append(weakref.ref(piece.poses))
            alive.append(weakref.ref(counts))
            most = max(most, sum(ref() is not None for ref in alive))

        reconstruct_stream(head, tmp_path / "pieces.parquet", each=watched)
    assert len(alive) == 3 * -(-N // PIECE)
    assert most <= 2 * 3


def test_the_command_streams(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_run(tmp_path / "run", spoiled(scheme("six")), suffix=".parquet")

    def whole(*_: object) -> Run:
        raise AssertionError("the whole run was read")

    monkeypatch.setattr("lmeasure.recording.run.read_run", whole)
    arguments = ["reconstruct", tmp_path / "run", "--out", tmp_path / "a.parquet", "--rerun", tmp_path / "a.rrd"]
    assert f"{N} samples" in ran(*arguments)
    assert len(cells(tmp_path / "a.rrd")["/position_mm/x_mm", "Measurements:values"]) == N


def test_a_run_that_breaks_late_leaves_neither_file(tmp_path: Path) -> None:
    run = spoiled(scheme("six"))
    run.passes[0].time_s[1400] = run.passes[0].time_s[1399]
    write_run(tmp_path / "run", run, suffix=".parquet")
    head = read_run_head(tmp_path / "run")
    with pytest.raises(FileFormatError, match="sample 1400"), streamed_recording(tmp_path / "out" / "a.rrd", head) as each:
        reconstruct_stream(head, tmp_path / "out" / "a.parquet", each=each)
    assert list((tmp_path / "out").iterdir()) == []


@given(st.lists(st.integers(1, 60), min_size=1, max_size=12), st.integers(1, 40), st.sets(st.integers(0, 700), max_size=5))
def test_thinned_rows_are_few_even_and_what_was_given(sizes: list[int], limit: int, kept: set[int]) -> None:
    thinned, n = Thinned(limit, 1), sum(sizes)
    kept = {k for k in kept if k < n}
    first = 0
    for size in sizes:
        mine = np.array(sorted(k - first for k in kept if first <= k < first + size), dtype=np.int64)
        thinned.add(np.arange(first, first + size, dtype=np.float64)[:, None], mine)
        first += size
    numbers = thinned.numbers.tolist()
    assert thinned.rows[:, 0].tolist() == numbers
    assert numbers == sorted(set(numbers))
    assert kept | {0, n - 1} <= set(numbers)
    even = {k for k in numbers if k not in kept and k != n - 1}
    assert len(even) <= 2 * limit
    assert len(numbers) >= min(n, limit) / 2
    assert any(even <= set(range(0, n, step)) <= set(numbers) for step in range(1, n + 1))
