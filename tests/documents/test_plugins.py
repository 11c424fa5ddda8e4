"""The example packages of docs/extending.md, built, installed into an empty folder and used by commands; and a package that is broken."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
from log_fuzz import six_cables

from lmeasure.rig import write_rig
from lmeasure.simulation import cell_rig

PLUGINS = Path(__file__).parents[2] / "docs" / "plugins"
UNIT = (0.0, 0.0, 0.0, 1.0)
POSE = ["--position-mm", "1,2,3", "--quaternion-xyzw", "0,0,0,1"]
BROKEN = """[lmeasure.sensors]
crow = crow:KIND
[lmeasure.log_formats]
magpie = magpie:FORMAT
crow = crow:FORMAT
dove = dove:FORMAT
[lmeasure.robot_programs]
magpie = magpie:DIALECT
jay = json:loads
raven = json:loads
[lmeasure.characteristics]
magpie = magpie:CLAUSE
"""
FAILING = """from lmeasure.acquisition import LogFormat
def read(path, file, report):
    yield {}["frames"]
from lmeasure.sensors import LengthSensor, SensorKind
class Crow(LengthSensor):
    kind = "crow"
KIND = SensorKind(table=Crow, reading=lambda own, place, turn: own[7])
FORMAT = LogFormat(name="crow", label="Crow", read=read, suffixes=(".crw",))
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment that has these packages besides what runs here, and one whose module cannot be imported."""
    folder = tmp_path_factory.mktemp("plugins")
    sources = [folder / "sources" / name for name in ("log_format", "robot_program", "characteristic", "sensor")]
    for source in sources:
        shutil.copytree(PLUGINS / source.name, source)
    words = ["install", "-q", "--disable-pip-version-check", "--no-deps", "--no-build-isolation", "--target", folder / "installed"]
    done = subprocess.run([sys.executable, "-m", "pip", *map(str, [*words, *sources])], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    of_broken = folder / "installed" / "magpie-0.3.dist-info"
    of_broken.mkdir()
    (of_broken / "METADATA").write_text("Metadata-Version: 2.1\nName: magpie\nVersion: 0.3\n")
    (of_broken / "entry_points.txt").write_text(BROKEN)
    second = folder / "installed" / "raven-0.1.dist-info"
    second.mkdir()
    (second / "METADATA").write_text("Metadata-Version: 2.1\nName: raven\nVersion: 0.1\n")
    (second / "entry_points.txt").write_text("[lmeasure.robot_programs]\nraven = magpie:DIALECT\n")
    (folder / "installed" / "magpie.py").write_text("1 / 0\n")
    (folder / "installed" / "crow.py").write_text(FAILING)
    (folder / "installed" / "dove.py").write_text(FAILING.replace('(".crw",)', '".dov"'))
    return folder / "installed"


class Done(NamedTuple):
    """What a command ended with, and what it wrote on standard output and standard error."""

    code: int
    out: str
    err: str


COMMANDS = """
import contextlib, io, json, sys
from lmeasure.cli.app import main
ended = []
for words in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    sys.argv = ["lmeasure", *words]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            ended.append([end.code or 0, out.getvalue(), err.getvalue()])
print(json.dumps(ended))
"""


def run(installed: Path, *commands: list[object]) -> list[Done]:
    """Commands in that environment, one behind the other in one process."""
    environment = {**os.environ, "PYTHONPATH": str(installed), "PYTHONDONTWRITEBYTECODE": "1"}
    words = json.dumps([list(map(str, command)) for command in commands])
    done = subprocess.run([sys.executable, "-c", COMMANDS, words], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    return [Done(*one) for one in json.loads(done.stdout)]


def test_an_example_is_short() -> None:
    packages = [folder for folder in PLUGINS.iterdir() if folder.is_dir()]
    assert len(packages) >= 3
    for folder in packages:
        assert {path.suffix for path in folder.iterdir() if path.is_file()} == {".toml", ".py"}
        assert sum(len(path.read_text(encoding="utf-8").splitlines()) for path in folder.glob("*.*")) < 80, folder


BEARING = """
[[bearing]]
channel = "st{n}"
counts_per_revolution = 1048576
position_mm = {place}
u_position_mm = 2.0
to = "P{n}"
zero_deg = 10.0
u_zero_deg = 0.5
u_reading_deg = 0.0005
"""
SCENARIO = """schema = "lmeasure.scenario/1"
rig = "rig.toml"
seed = 4
rate_hz = 50.0
[[waypoint]]
position_mm = [60.0, 20.0, -40.0]
[[waypoint]]
position_mm = [-50.0, 70.0, 30.0]
quaternion_xyzw = [0.0871557, 0.0, 0.0, 0.9961947]
[reference_poses]
count = 16
u_position_mm = 0.02
u_rotation_deg = 0.002
"""
PROGRAM = """schema = "lmeasure.program/1"
[[pose]]
name = "P1"
position_mm = [60.0, 20.0, -40.0]
quaternion_xyzw = [0.0, 0.0, 0.0, 1.0]
windows_s = [[0.4, 0.5]]
"""


def test_a_sensor_of_another_package_goes_the_whole_way(installed: Path, tmp_path: Path) -> None:
    """From a rig file to a certificate, with errors as large as stated against what was simulated."""
    rig = tmp_path / "rig.toml"
    write_rig(rig, cell_rig(3))
    plain = rig.read_text()
    rig.write_text(plain + BEARING.format(n=1, place=[2500.0, -300.0, 400.0]) + BEARING.format(n=2, place=[-300.0, 2500.0, 400.0]))
    (tmp_path / "crow.toml").write_text(plain + '[[crow]]\nchannel = "cr1"\ncount_length_mm = 0.1\n')
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    (tmp_path / "crow_scenario.toml").write_text(SCENARIO.replace("rig.toml", "crow.toml"))
    (tmp_path / "program.toml").write_text(PROGRAM)
    run_, calibrated, found = tmp_path / "run", tmp_path / "calibrated", tmp_path / "t.csv"
    own = ["--rig", calibrated / "rig.toml"]
    box = ["--x", "0:0:1", "--y", "0:0:1", "--z", "0:100:100"]
    *steps, verified, crow = run(
        installed,
        ["simulate", tmp_path / "scenario.toml", "--out", run_],
        ["calibrate", run_ / "calibration", "--out", calibrated],
        ["reconstruct", run_, *own, "--out", found],
        ["zone", calibrated / "rig.toml", *box, "--out", tmp_path / "zone.nc"],
        ["certify", found, "--run", run_, *own, "--program", tmp_path / "program.toml", "--out", tmp_path / "certificate"],
        ["verify", tmp_path / "certificate"],
        ["simulate", tmp_path / "crow_scenario.toml", "--out", tmp_path / "crow_run"],
    )
    assert [step.code for step in steps] == [0] * 5, steps
    assert verified.code == 0, verified
    assert "2 of 2 nodes are in the zone" in steps[3].out
    record = json.loads((calibrated / "calibration.json").read_text())
    true = dict(zip("xyz", (2500.0, -300.0, 400.0), strict=True))
    solved = {p["name"]: p for p in record["parameters"] if p["name"].startswith("st1.")}
    assert set(solved) == {"st1.zero_deg", *(f"st1.position_{axis}_mm" for axis in "xyz")}
    for axis, value in true.items():
        p = solved[f"st1.position_{axis}_mm"]
        assert abs(p["value"] - value) <= 3.0 * p["u"]
    # across the line of sight the poses tell the station well, its height not at all
    assert solved["st1.position_x_mm"]["u"] < 0.2
    assert solved["st1.position_z_mm"]["u"] == pytest.approx(2.0, rel=0.01)
    t, truth = pd.read_csv(found), pd.read_parquet(run_ / "truth.parquet")
    assert (t["status"] == "ok").all()
    ratio = [(t[f"{c}_mm"] - truth[f"{c}_mm"]) / t[f"u_{c}_mm"] for c in "xyz"]
    assert 0.2 < np.sqrt(np.mean(np.square(ratio))) < 2.5
    # a law that fails is a line and no crash
    assert crow.code == 1
    assert "crow cr1 has no reading there" in crow.err
    (elsewhere,) = run(tmp_path, ["reconstruct", run_, "--out", tmp_path / "u.csv"])
    assert elsewhere.code == 1
    assert "unknown key 'bearing'" in elsewhere.err


def test_a_log_of_another_package_is_imported(installed: Path, tmp_path: Path) -> None:
    counts = np.arange(60).reshape(10, 6) * 1000 - 20000
    lines = ["#PELICAN 1"]
    for i, row in enumerate(counts.tolist()):
        time = 1.0 + 0.01 * i
        lines.append(f"{time:.6f} 080 :")
        lines += [
            f"{time + 1e-4 * j:.6f} {0x180 + j:03X} : {k.to_bytes(4, 'little', signed=True).hex(' ').upper()}" for j, k in enumerate(row, 1)
        ]
    (tmp_path / "drive.pel").write_text("\n".join([*lines, "out of paper", ""]))
    write_rig(tmp_path / "rig.toml", six_cables())
    # as text of any name it is recognised by its first line
    (tmp_path / "drive.txt").write_text("\n".join([*lines, ""]))
    (tmp_path / "x.mag").write_text("some text\n")
    (tmp_path / "x.crw").write_text("some text\n")
    (tmp_path / "x.log").write_text("(1.000000) can0 181#01020304\n")
    scan = [["import", tmp_path / name, "--scan"] for name in ("drive.txt", "x.log", "x.mag", "x.crw")]
    pel = ["import", tmp_path / "drive.pel", "--rig", tmp_path / "rig.toml", "--out", tmp_path / "run", *POSE]
    done, text, ours, broken, failing = run(installed, pel, *scan)
    assert done.code == 0, done.err
    read = np.loadtxt(tmp_path / "run" / "pass1.csv", delimiter=",", skiprows=1)
    assert np.array_equal(read[:, 1:7], counts)
    assert "1 of 72 lines could not be read (1 broken); the first is line 72: 'out of paper' (not as a Pelican writes it)" in done.out
    assert "Pelican's text log" in text.out
    # a broken package stops only what needs it
    assert ours.code == 0
    assert (broken.code, len(broken.err.splitlines())) == (1, 1)
    assert "is no log this program reads" in broken.err
    assert "; package magpie 0.3: magpie (magpie:FORMAT) cannot be loaded: ZeroDivisionError" in broken.err
    assert "; package magpie 0.3: dove (dove:FORMAT) cannot be loaded: TypeError: suffixes must be a tuple of texts such as" in broken.err
    fault = "KeyError in crow.py:3: 'frames'"
    assert failing.err == f"lmeasure: a fault of package magpie 0.3, not of lmeasure: {fault}. No file is half-written\n"


def test_a_program_of_another_package_is_corrected(installed: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    off = np.array([1.0, -0.5, 0.25])
    rows = [[*place, *UNIT, *off, 0.0, 0.0, 0.0] for place in rng.uniform(-200.0, 200.0, (60, 3))]
    head = "x_mm,y_mm,z_mm,qx,qy,qz,qw,dx_mm,dy_mm,dz_mm,drx_deg,dry_deg,drz_deg"
    (tmp_path / "map.csv").write_text("\n".join([head, *(",".join(map(repr, map(float, row))) for row in rows), ""]))
    (tmp_path / "pick.hrn").write_text("SPEED 100\nGO P1 AT 10.0 20.0 -30.0 0.0 0.0 0.0\nGO P2 AT 10.0 20.0\nGRIP\n")
    correct = ["correct", tmp_path / "pick.hrn", "--map", tmp_path / "map.csv", "--out", tmp_path / "out"]
    others = [[*correct, "--force", "--dialect", name] for name in ("jay", "rook", "raven")]
    done, jay, rook, raven = run(installed, correct, *others)
    assert done.code == 0, done.err
    assert "1 of 1 target corrected (heron), 1 position not read" in done.out
    assert "pick.hrn:3: P2: 2 numbers, and a pose has 6" in done.out
    assert (jay.code, len(jay.err.splitlines())) == (1, 1)
    assert jay.err.startswith("lmeasure: package magpie 0.3: jay (json:loads) is a function and no Dialect")
    assert (raven.code, raven.err) == (1, "lmeasure: raven: package magpie 0.3 and package raven 0.1 both add it; remove one of them\n")
    assert rook.code == 2
    assert "'rook' is none of krl, rapid, fanuc, ur-script, csv, robodk, heron, jay, magpie, raven" in rook.err
    lines = (tmp_path / "out" / "pick.hrn").read_text().splitlines()
    assert [lines[0], *lines[2:]] == ["SPEED 100", "GO P2 AT 10.0 20.0", "GRIP"]
    numbers = [float(word) for word in lines[1].split()[3:]]
    assert numbers == pytest.approx([*(np.array([10.0, 20.0, -30.0]) - off), 0.0, 0.0, 0.0], abs=0.01)


def test_a_characteristic_of_another_package_is_certified(installed: Path, tmp_path: Path) -> None:
    """Farthest of the means over the windows, in the certificate and on its first page, with the package among the versions."""
    rng = np.random.default_rng(2)
    attained = np.array([100.0, 0.0, 50.0]) + rng.normal(0.0, 0.1, (5, 3))
    time_s = np.arange(500) / 100.0
    places = attained[np.minimum(time_s.astype(int), 4)]
    table = np.column_stack([time_s, places, np.tile(UNIT, (500, 1))])
    (tmp_path / "t.csv").write_text(
        "time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw\n" + "".join(",".join(map(repr, row)) + "\n" for row in table.tolist())
    )
    windows = [[i + 0.3, i + 0.9] for i in range(5)]
    pose = f'[[pose]]\nname = "P1"\nposition_mm = [100.0, 0.0, 50.0]\nquaternion_xyzw = [0.0, 0.0, 0.0, 1.0]\nwindows_s = {windows}\n'
    certify: dict[str, list[object]] = {}
    for name in ("farthest", "magpie", "no-such", "farthest twice"):
        program = tmp_path / f"{name}.toml"
        names = [name] if "twice" not in name else ["farthest", "farthest"]
        program.write_text(f'schema = "lmeasure.program/1"\ncharacteristics = {names}\n{pose}')
        certify[name] = ["certify", tmp_path / "t.csv", "--u-position-mm", "0.01", "--u-rotation-deg", "0.01", "--program", program]
        certify[name] += ["--out", tmp_path / name, "--language", "en"]
    done, broken, unknown, twice, again = run(installed, *certify.values(), ["verify", tmp_path / "farthest"])
    assert done.code == 0, done.err
    content = json.loads((tmp_path / "farthest" / "certificate.json").read_text())
    (found,) = [c for c in content["characteristics"] if c["name"] == "FP_max"]
    assert found["value"] == pytest.approx(np.linalg.norm(attained - [100.0, 0.0, 50.0], axis=1).max(), rel=1e-9)
    assert found["u95"] == pytest.approx(0.02, rel=0.5)
    assert content["environment"]["plug-in farthest"] == "lmeasure-farthest 1.0"
    page = (tmp_path / "farthest" / "report.html").read_text(encoding="utf-8")
    assert re.search(r"FP<sub>max</sub>.{0,40}farthest attained position", page)
    assert again.code in (0, 3), again.out
    loading = "package magpie 0.3: magpie (magpie:CLAUSE) cannot be loaded: ZeroDivisionError: division by zero"
    assert broken[::2] == (1, f"lmeasure: {loading}\n")
    assert unknown[::2] == (1, "lmeasure: characteristics: no installed package adds 'no-such'. Added are: farthest, magpie\n")
    assert twice.code == 1
    assert "characteristics: FP_max of P1 is computed twice" in twice.err
    assert not (tmp_path / "magpie").exists()
    (elsewhere,) = run(tmp_path, ["verify", tmp_path / "farthest"])
    assert "no installed package adds 'farthest'" in elsewhere.out + elsewhere.err
