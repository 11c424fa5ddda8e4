"""Whatever the bytes of a run folder are, reading and reconstructing it ends in poses or in one line: never in a traceback.

Half of the cases change bytes, half change values of a valid document, so that the checks behind the parser are reached too.
"""

import copy
import math
import random
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import test_rig
import tomli_w

from lmeasure.core import LMeasureError
from lmeasure.recording import read_counts, read_poses, read_run
from lmeasure.rig import read_calibration_record, read_rig
from lmeasure.sensors import lengths_from_counts

RUN = b"""schema = "lmeasure.run/1"
rig = "rig.toml"
[start]
position_mm = [1.0, 2, 3]
quaternion_xyzw = [0.0, 0.0, 0.0, 1.0]
[[pass]]
counts = "pass1.csv"
[[pass]]
counts = "pass2.csv"
"""
COUNTS = b"time_s,ch1,ch2,sync\n0,0,0,0\n0.001,5,7,0\n0.002,9,,1\n0.003,-12,8,1\n"
POSES = b"pose,x_mm,y_mm,z_mm,qx,qy,qz,qw,u_position_mm\n1,0,0,0,0,0,0,1,0.1\nb,1,2,3,0.5,0.5,0.5,0.5,0.1\n"
RECORD = (
    b'{"rig": "demo", "parameters": [{"name": "B1.x_mm", "value": 1.0, "u": 0.1, "prior_u": 3}], "covariance": [[0.01]], '
    b'"residuals": [], "equations": 3, "unknowns": 1, "rank": 1}'
)
WORDS = [b"nan", b"inf", b"-1e400", b"12abc", b"true", b"", b",", b'"', b"\n", b"\r", b"\x00", b"\xff", b"[", b"]", b"=", b"9" * 30, b"../"]
VALUES: list[Any] = [
    None, True, -1, 0, 0.5, 10**30, 1e300, -1e300, math.nan, math.inf, "", "x", "12", "a\nb", "\u0000", "ch1", "B1", [], [1], [1, 2, 3],
    [[1, 2], 3, 4], ["1", 2, 3], {}, {"x": 1},
]  # fmt: skip


def scrambled(content: bytes, r: random.Random) -> bytes:
    """The content with a few bytes changed, cut, doubled or replaced by a word."""
    out = bytearray(content)
    for _ in range(r.choice([1, 1, 2, 5])):
        at, length = r.randrange(len(out) + 1), r.choice([0, 1, 1, 3, 12, 80])
        kind = r.randrange(4)
        if kind == 0:
            out[at : at + length] = r.choice(WORDS)
        elif kind == 1:
            out[at : at + length] = bytes(r.randrange(256) for _ in range(r.choice([1, 2, 8])))
        elif kind == 2:
            out[at:at] = out[at : at + length]
        else:
            del out[at : at + length]
    return bytes(out)


def altered(document: dict[str, Any], r: random.Random) -> bytes:
    """The document as TOML with one value anywhere replaced, dropped or put under another key."""
    out = copy.deepcopy(document)
    here: Any = out
    while True:
        key = r.choice(list(here)) if isinstance(here, dict) else r.randrange(len(here))
        if isinstance(here[key], dict | list) and len(here[key]) and r.random() < 0.8:
            here = here[key]
            continue
        break
    value = r.choice(VALUES)
    if value is None:
        del here[key]
    elif isinstance(here, dict) and r.random() < 0.2:
        here[r.choice(["", "x", "name_mm", "position_m"])] = value
    else:
        here[key] = value
    return tomli_w.dumps(out).encode()


def outcome(action: Callable[[], Any]) -> str:
    """ "read", or the line it was refused with; anything else than an LMeasureError is the failure this looks for."""
    try:
        action()
    except LMeasureError as error:
        text = str(error)
        assert text
        assert "\n" not in text
        assert len(text) < 2000
        return text
    return "read"


def valid(folder: Path) -> None:
    (folder / "rig.toml").write_text(test_rig.RIG)
    (folder / "run.toml").write_bytes(RUN)
    (folder / "pass1.csv").write_bytes(COUNTS)
    (folder / "pass2.csv").write_bytes(COUNTS)


def use(folder: Path) -> None:
    lengths = lengths_from_counts(read_run(folder))
    assert np.isfinite(lengths.change_mm[lengths.flags == 0]).all()


@pytest.mark.parametrize("name", ["rig.toml", "run.toml", "pass1.csv", "pass2.csv"])
def test_bytes_of_a_run_folder(tmp_path: Path, name: str) -> None:
    valid(tmp_path)
    content = (tmp_path / name).read_bytes()
    use(tmp_path)
    r = random.Random(name)
    outcomes = []
    for _ in range(250):
        (tmp_path / name).write_bytes(scrambled(content, r))
        outcomes.append(outcome(lambda: use(tmp_path)))
    assert len(set(outcomes)) > 20, "the scrambling reaches many checks"


@pytest.mark.parametrize("name", ["rig.toml", "run.toml"])
def test_values_of_a_run_folder(tmp_path: Path, name: str) -> None:
    valid(tmp_path)
    document = tomllib.loads((tmp_path / name).read_text())
    r = random.Random(name)
    outcomes = []
    for _ in range(400):
        (tmp_path / name).write_bytes(altered(document, r))
        outcomes.append(outcome(lambda: use(tmp_path)))
    assert len(set(outcomes)) > 40
    assert outcomes.count("read") < len(outcomes) / 3


@pytest.mark.parametrize(
    ("content", "suffix", "read"),
    [
        (POSES, ".csv", lambda p: read_poses(p, "puma-oat")),
        (RECORD, ".json", read_calibration_record),
        (test_rig.RIG.encode(), ".toml", lambda p: read_rig(p).cable_rows()),
        (COUNTS, ".csv", read_counts),
        (COUNTS, ".parquet", read_counts),
    ],
    ids=["poses", "record", "rig", "counts", "parquet"],
)
def test_bytes_of_single_files(tmp_path: Path, content: bytes, suffix: str, read: Callable[[Path], Any]) -> None:
    path = tmp_path / f"file{suffix}"
    if suffix == ".parquet":
        import pyarrow as pa
        import pyarrow.parquet

        pyarrow.parquet.write_table(pa.table({"time_s": [0.0, 1.0], "ch1": [1, 2]}), path)
        content = path.read_bytes()
    r = random.Random(suffix + str(len(content)))
    for _ in range(250):
        path.write_bytes(scrambled(content, r))
        outcome(lambda: read(path))
