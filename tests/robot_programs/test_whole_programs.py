"""Programs of 200 lines and more, one of each dialect, beside readers that share nothing with lmeasure: the same targets, in the same
places, through the same frames; and there and back with nothing else changed."""

import re
from dataclasses import replace

import numpy as np
import pytest
from program_readers import fanuc, rapid, table
from program_runs import krl, script
from program_words import Met
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
"""Of the controllers: matrices for the readers of the tests, poses for lmeasure."""


def read(name: str) -> tuple[Dialect, Listing]:
    paths = [FOLDER / file for file in WHOLE[name]]
    sources = opened(paths)
    dialect = dialect_of(paths, sources)
    assert dialect.name == name
    stated = {re.sub(r"^(U[FT])(\d)$", r"\1[\2]", key): se3.pose(m[:3, 3], Rotation.from_matrix(m[:3, :3])) for key, m in FRAMES.items()}
    return dialect, dialect.read(sources).stated(stated)


def met_by(name: str) -> Met:
    texts = {file: (FOLDER / file).read_bytes().decode("latin-1") for file in WHOLE[name]}
    first = next(iter(texts.values()))
    return krl(texts, FRAMES) if name == "krl" else {"rapid": lambda: rapid(first, FRAMES), "fanuc": lambda: fanuc(first, FRAMES),
        "ur-script": lambda: script(first)}[name]()  # fmt: skip


@pytest.mark.parametrize(("name", "targets", "several"), [("krl", 22, 3), ("rapid", 18, 0), ("fanuc", 15, 0), ("ur-script", 17, 1)])
def test_an_independent_reader_meets_the_same_targets(name: str, targets: int, several: int) -> None:
    """Run by chance hundreds of times: a target is what is moved to in one place alone; lmeasure follows all ways at once instead."""
    dialect, listing = read(name)
    alone = name != "krl"
    met = {(place if not alone else ("", place[1])): every for place, every in met_by(name).items()}
    single = {}
    for place, every in met.items():
        poses = [p for p, _ in every]
        if all(p is not None and np.allclose(p, poses[0], atol=1e-6) for p in poses):
            single[place] = every[0]
    mixed = sum(1 for every in met.values() if len({str(p) for p, _ in every if p is not None}) > 1)
    found = {("" if alone else listing.sources[t.source].name, t.spans[0][0]): t for t in listing.targets}
    assert {p: t.name for p, t in found.items()}.keys() == single.keys()
    assert (len(found), mixed) == (targets, several)
    for place, target in found.items():
        value, flags = single[place]
        assert dict(target.flags) == flags, target
        if target.joints:
            assert list(target.values) == list(value)
        else:
            pose = se3.compose(listing.frames[target.base], dialect.pose(target.values))
            pose = se3.compose(pose, se3.inverse(listing.frames[target.tool]))
            np.testing.assert_allclose(homogeneous(list(pose[:3]), se3.matrices(pose)), value, atol=1e-6)


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
