"""Every command is given, in place of each file that it reads, what people give by mistake: it ends in one line, or a line for each fault
of the file, that names the file; nothing is written, no exception comes through."""

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from in_process import ran
from typer.testing import CliRunner

from lmeasure.cli.app import app
from lmeasure.core import LMeasureError
from lmeasure.text import Message, faults
from lmeasure.workflows import COMMANDS

HERE = Path(__file__).parents[1]
TRUTH = HERE / "authorities" / "truth"
SEALED = HERE / "authorities" / "sealed" / "with-run"
BOX = "--box=-100:100,-100:100,-100:100"
GRID = "--x 0:100:50 --y 0:100:50 --z 0:100:50"
WRONG: dict[str, bytes | None] = {
    "missing": None,
    "folder": None,
    "empty": b"",
    "binary": bytes(range(256)) * 40,
    "letter.txt": b"Dear colleague,\nthe counts of Tuesday, as you asked\n",
    "other.toml": b'schema = "lmeasure.nothing/1"\n',
    "half.toml": b'schema = "lmeasure.rig/1"\n[[observation_point]]\nposition_mm = [1,\n',
    "sheet.csv": b"Datum;X;Y\n1;2,5;3\n",
    "head.csv": b"time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw\n",
    "nan.csv": b"pose,time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw,ch1\n1,nan,nan,nan,nan,nan,nan,nan,nan,nan\n",
    "short.csv": b"pose,time_s,x_mm\n1,0,5\n2,1\n",
    "broken.parquet": b"PAR1 garbage PAR1",
    "broken.zip": b"PK\x03\x04 garbage",
    "list.json": b"[]",
}
PROGRAM = """/PROG A
/MN
   1:L P[1] 100mm/sec FINE ;
/POS
P[1]{
   GP1:
    UF : 0, UT : 0, CONFIG : 'N U T, 0, 0, 0',
    X = 500.000 mm, Y = 0.000 mm, Z = 600.000 mm,
    W = 180.000 deg, P = 0.000 deg, R = 0.000 deg
};
/END
"""
NAMES = re.compile(r"`[^`]*`|'[^']*'|--[\w-]+|\[\[?[^\]]*\]\]?|\S*[/_=\\]\S*|\w*(?:\.\w+)+|\b\w+:|\S*\d\S*|netCDF|lmeasure \w+|schema")
"""Commands, files, options, tables and keys: they are the same in every language."""
QUOTED = ("broken", "columns", "error", "has", "known", "listed", "reason", "where2")
"""Values that are names, or the words of another library."""
ENGLISH = re.compile(r"(?<![A-Za-zа-я])(?!rerun|nan\b)[a-z]{3,}")
COMMAND_LINES = (
    "simulate {} --out new", "place {} --task placement.toml --out new", "place rig.toml --task {} --out new",
    "drum {} --rig rig.toml --out new.toml", "drum drums.toml --rig {} --out new.toml", "scan --bus replay:{}",
    "check --rig {} --bus virtual:wrong", f"plan-poses {{}} --poses 4 {BOX} --out new.csv",
    f"plan-poses rig.toml --extend {{}} --poses 4 {BOX} --out new.csv", "capture {} --poses poses.csv --bus virtual:wrong --out new",
    "capture rig.toml --poses {} --bus virtual:wrong --out new", "calibrate {} --out new", "calibrate run --self --rig {} --out new",
    "check-instrument {} --out new", "check-instrument run --rig {} --out new", f"zone {{}} {GRID} --out new.nc",
    f"zone rig.toml {GRID} --path {{}} --out new.nc", f"zone rig.toml {GRID} --bodies {{}} --out new.nc", "structure {} --out new.json",
    "record --rig {} --bus virtual:wrong --out new", "watch --rig {} --bus virtual:wrong",
    "record --rig rig.toml --bus replay:{} --fast --out new", "import {} --rig rig.toml --out new", "import log.log --rig {} --out new",
    "import log.log --rig rig.toml --dbc {} --out new", "import log.log --rig rig.toml --start {} --out new", "import {} --scan",
    "reconstruct {} --out new.csv", "reconstruct run --rig {} --out new.csv", "reconstruct run --start {} --out new.csv",
    "motion {} --out new.csv", "report {} --out new", "view {}", "program --zone {} --out new", "program --ran {} --out tests",
    "certify {} --program sealed/inputs/program.toml --out new", "certify sealed/inputs/trajectory.parquet --program {} --out new",
    "certify sealed/inputs/trajectory.parquet --program sealed/inputs/program.toml --run {} --out new",
    "certify sealed/inputs/trajectory.parquet --program sealed/inputs/program.toml --details {} --out new",
    "certify sealed/inputs/trajectory.parquet --program sealed/inputs/program.toml --key {} --out new", "verify {}", "compare {} sealed",
    "compare sealed {}", "identify --robot {} --measurements poses.csv --out new", "identify --robot ur5 --measurements {} --out new",
    "correct program.ls --identified {} --out new", "mechanism {}", "mechanism rotopod --poses {} --joints new.csv", "dyads {} --out new",
    "frames --robot {} --measured poses.csv --out new", "frames --robot poses.csv --measured {} --out new", "play {} --bus virtual:wrong",
    "register reg --add {}", "compare --between {} sealed", "qualify --key {} --out new",
)  # fmt: skip


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Right files, and the wrong ones."""
    here, before = tmp_path_factory.mktemp("desk"), Path.cwd()
    shutil.copytree(TRUTH / "cell-run", here / "run")
    shutil.copytree(SEALED, here / "sealed")
    shutil.copy(TRUTH / "cell-run" / "rig.toml", here / "rig.toml")
    (here / "log.log").write_text("(1.0) can0 181#00000000\n(1.1) can0 181#01000000\n")
    rows = (f"{i},{x},{y},{z},0,0,0,1" for i, (x, y, z) in enumerate([(0, 0, 0), (100, 0, 0), (0, 100, 0), (0, 0, 100)], 1))
    (here / "poses.csv").write_text("\n".join(["pose,x_mm,y_mm,z_mm,qx,qy,qz,qw", *rows, ""]))
    shutil.copytree(SEALED / "inputs", here / "tests")
    (here / "program.ls").write_text(PROGRAM)
    os.chdir(here)
    ran("init", "cell", "--template", "six-cables")
    for name in ("placement.toml", "drums.toml"):
        shutil.copy(here / "cell" / name, here / name)
    (here / "wrong").mkdir()
    for name, content in WRONG.items():
        if content is not None:
            (here / "wrong" / name).write_bytes(content)
    (here / "wrong" / "folder").mkdir()
    try:
        yield here
    finally:
        os.chdir(before)


def test_every_command_that_reads_is_here() -> None:
    assert set(COMMANDS) - {line.split()[0] for line in COMMAND_LINES} == {
        "workbench", "demo", "docs", "init", "inspect", "schema", "key", "batch", "warm",
    }  # fmt: skip


def own_words(one: Message) -> str:
    """Return a message in Russian without what it quotes."""
    values = {key: own_words(v) if isinstance(v, Message) else "" if key in QUOTED else v for key, v in one.values.items()}
    return Message(one.code, values, one.template).text("ru")


@pytest.mark.parametrize("line", COMMAND_LINES)
def test_a_wrong_file_is_named_in_a_line(line: str, desk: Path) -> None:
    there = {p.relative_to(desk) for p in desk.rglob("*")}
    # every other wrong file, others of each second command
    for name in list(WRONG)[COMMAND_LINES.index(line) % 2 :: 2]:
        words = line.replace("{}", f"wrong/{name}").split()
        done = CliRunner().invoke(app, words)
        error = done.exception
        assert isinstance(error, LMeasureError | SystemExit), (words, repr(error))
        assert done.exit_code in (1, 2), words
        reported = error.lines if isinstance(error, LMeasureError) else done.output.splitlines()
        assert any(name in text for text in reported), (words, reported)
        assert not any("Traceback" in text or "Error(" in text or "\n" in text for text in reported), (words, reported)
        assert {p.relative_to(desk) for p in desk.rglob("*")} == there, words
        for fault in faults(error) if isinstance(error, LMeasureError) else ():
            assert isinstance(fault, Message), (words, fault)
            russian = own_words(fault)
            assert not ENGLISH.search(NAMES.sub("", russian)), (words, russian)
