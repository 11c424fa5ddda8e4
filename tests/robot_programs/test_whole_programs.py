"""Programs of 200 lines and more, one of each dialect, beside what readers met that share nothing with lmeasure: the same targets, in the
same places, through the same frames; and there and back with nothing else changed."""

import csv
import io
import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from programs import FOLDER, WHOLE, about, homogeneous
from scipy.spatial.transform import Rotation

from lmeasure.core import se3
from lmeasure.robot_programs import Dialect, Listing, dialect_of, opened
from lmeasure.robot_programs.program import rewritten

FRAMES = {
    "BASE_DATA[4]": homogeneous([350, -640, 120], about(2, 30)),
    "UF1": homogeneous([700, 350, 300], about(2, 25)),
    "UF2": homogeneous([700, -380, 310], about(2, -30) @ about(1, -0.1) @ about(0, 0.2)),
    "UF3": homogeneous([650, -300, 250], np.eye(3)),
    "UT1": homogeneous([0, 0, 100], np.eye(3)),
    "UT2": homogeneous([15, -2.5, 180], about(1, -20)),
}
"""Of the controllers."""
MET: dict[str, list[Any]] = json.loads((FOLDER / "met.json").read_text(encoding="utf-8"))


def read(name: str) -> tuple[Dialect, Listing]:
    paths = [FOLDER / file for file in WHOLE[name]]
    sources = opened(paths)
    dialect = dialect_of(paths, sources)
    assert dialect.name == name
    stated = {re.sub(r"^(U[FT])(\d)$", r"\1[\2]", key): se3.pose(m[:3, 3], Rotation.from_matrix(m[:3, :3])) for key, m in FRAMES.items()}
    return dialect, dialect.read(sources).stated(stated)


@pytest.mark.parametrize("name", MET)
def test_an_independent_reader_met_the_same_targets(name: str) -> None:
    """Each was moved to in one place alone by a reader that ran the program by chance hundreds of times and shared no code with lmeasure:
    by source and place of its first number, three rows of the flange's matrix, or joint values, and the target's flags."""
    dialect, listing = read(name)
    sources = [source.name if name == "krl" else "" for source in listing.sources]
    found = {(sources[t.source], t.spans[0][0]): t for t in listing.targets}
    assert found.keys() == {(source, place) for source, place, _, _ in MET[name]}
    for source, place, value, flags in MET[name]:
        target = found[source, place]
        assert dict(target.flags) == flags, target
        if target.joints:
            assert list(target.values) == value
        else:
            pose = se3.compose(listing.frames[target.base], dialect.pose(target.values))
            pose = se3.compose(pose, se3.inverse(listing.frames[target.tool]))
            np.testing.assert_allclose(homogeneous(list(pose[:3]), se3.matrices(pose))[:3], np.reshape(value, (3, 4)), atol=1e-6)


def abc(x: float, y: float, z: float, a: float, b: float, c: float) -> np.ndarray:
    return homogeneous([x, y, z], about(2, a) @ about(1, b) @ about(0, c))


def table(text: str, columns: tuple[str, ...], separator: str, decimal: str) -> dict[str, np.ndarray]:
    """By name, poses of rows that are whole, through Python's own reader."""
    rows = [r for r in csv.reader(io.StringIO(text), delimiter=separator) if r and not r[0].startswith("#")]
    places = [rows[0].index(c) for c in columns]
    out = {}
    for row in rows[1:]:
        try:
            values = [float(row[i].replace(decimal, ".")) for i in places]
        except ValueError:
            continue
        if len(row) == len(rows[0]) and np.abs(values).max() < 1e6:
            out[row[0]] = abc(*values) if columns[3].startswith("a") else abc(*values[:3], *values[:2:-1])
    return out


@pytest.mark.parametrize(("name", "separator", "decimal", "poses"), [("csv", ";", ",", 187), ("robodk", ",", ".", 203)])
def test_tables_say_the_same_to_another_reader(name: str, separator: str, decimal: str, poses: int) -> None:
    dialect, listing = read(name)
    text = (FOLDER / WHOLE[name][0]).read_text(encoding="utf-8-sig")
    columns = ("x_mm", "y_mm", "z_mm", "a_deg", "b_deg", "c_deg") if name == "csv" else tuple(
        f"{axis} [{unit}]" for axes, unit in ((("X", "Y", "Z"), "mm"), (("Rx", "Ry", "Rz"), "deg")) for axis in axes)  # fmt: skip
    rows = table(text, columns, separator, decimal)
    assert list(rows) == [t.name for t in listing.targets]
    assert len(rows) == poses
    for target in listing.targets:
        pose = dialect.pose(target.values)
        np.testing.assert_allclose(homogeneous(list(pose[:3]), se3.matrices(pose)), rows[target.name], atol=1e-9)


@pytest.mark.parametrize("name", sorted(WHOLE))
def test_there_and_back_only_targets_change(name: str) -> None:
    """Every byte but those of the targets' numbers is as it was, and read again the targets are the new ones."""
    dialect, listing = read(name)
    assert sum(s.text.count("\n") for s in listing.sources) >= 200
    rng = np.random.default_rng(5)
    new: dict[int, list[float]] = {}
    poses = {}
    for i, target in enumerate(listing.targets):
        if target.joints:
            new[i] = [v + rng.uniform(-0.02, 0.02) for v in target.values]
        else:
            poses[i] = se3.displaced(dialect.pose(target.values), rng.uniform(-1, 1, 6) * [0.01, 0.01, 0.01, 3, 3, 3])
            new[i] = list(dialect.numbers(poses[i], target.values))
    texts = rewritten(listing, dialect, new)
    for k, (source, text) in enumerate(zip(listing.sources, texts, strict=True)):
        old, rest, at = source.text, text, 0
        for start, stop in sorted(s for t in listing.targets if t.source == k for s in t.spans):
            kept = old[at:start]
            assert rest.startswith(kept)
            number = re.match(r"[-+]?\d*[.,]?\d+(?:[eE][-+]?\d+)?", rest[len(kept) :])
            assert number is not None
            rest, at = rest[len(kept) + number.end() :], stop
        assert rest == old[at:]
    again = dialect.read([replace(s, text=t) for s, t in zip(listing.sources, texts, strict=True)]).stated(
        {n: f for n, f in listing.frames.items() if n not in listing.assumed}
    )
    reported = [(t.name, t.line, t.joints, t.base, t.tool, t.flags) for t in listing.targets]
    assert [(t.name, t.line, t.joints, t.base, t.tool, t.flags) for t in again.targets] == reported
    assert [str(u) for u in again.unread] == [str(u) for u in listing.unread]
    for i, target in enumerate(again.targets):
        if target.joints:
            np.testing.assert_allclose(target.values, new[i], atol=6e-4)
        else:
            off = se3.displacement(dialect.pose(target.values), poses[i])
            assert np.abs(off[3:]).max() < (6e-4 if name == "fanuc" else 1e-4)
            assert np.abs(off[:3]).max() < 2e-5
    same = {i: list(dialect.numbers(dialect.pose(t.values), t.values)) for i, t in enumerate(listing.targets) if not t.joints}
    assert rewritten(listing, dialect, same) == tuple(s.text for s in listing.sources)
