"""The whole way of a user from an empty folder, by commands alone: no file is written by hand. `pytest -s` shows what each took."""

import random
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated_cell import Person, cell, exchanged

from lmeasure.cli.app import main
from lmeasure.recording import read_poses
from lmeasure.rig import Rig, read_rig, rig_from_dict, write_rig
from lmeasure.sensors import span_lengths
from lmeasure.simulation import campaign_at

HERE = Path(__file__).parents[1]
PATIENCE_S = 500.0


def said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *words: Any, code: int = 0) -> str:
    """What a command prints; how long it took goes to the report."""
    begin = time.monotonic()
    monkeypatch.setattr("sys.argv", ["lmeasure", *map(str, words)])
    with pytest.raises(SystemExit) as stopped:
        main()
    out, err = capsys.readouterr()
    assert (stopped.value.code or 0) == code, err
    with capsys.disabled():
        print(f"\n{words[0]}: {time.monotonic() - begin:.1f} s", end="")
    return out


def built_like(nominal: Rig) -> Rig:
    """The rig that was built: points up to 15 mm and guides up to 2 degrees beside what the file says."""
    true = campaign_at(
        nominal, np.array([[0.0, 0, 0, 0, 0, 0, 1]]), np.random.default_rng(5), nominal_shift_mm=15.0, nominal_shift_deg=2.0
    ).nominal
    quick = [p.model_copy(update={"drum": p.drum.model_copy(update={"max_cable_speed_mm_s": 1e6})}) for p in true.observation_point]
    return true.model_copy(update={"observation_point": tuple(quick)})


def wired_wrongly(rig: Rig) -> Rig:
    """As it was built: the plugs of two encoders exchanged, the wires of a third."""
    data = exchanged(rig, 1, 4)
    data["observation_point"][2]["drum"]["count_sign"] = -1
    return rig_from_dict(data)


def walked(capsys: pytest.CaptureFixture[str], person: Person, *words: Any, code: int = 0) -> list[str]:
    """What a command says in a process of its own, while a person does what it asks and presses Enter."""
    begin, lines = time.monotonic(), []
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-m", "lmeasure", *map(str, words)], **pipes) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        # what goes wrong here, or never ends, ends the command too: nobody would wait for it
        patience = threading.Timer(PATIENCE_S, process.kill)
        patience.start()
        try:
            for line in process.stdout:
                lines.append(line.rstrip())
                if line.rstrip().endswith("then press Enter"):
                    person.do(line.partition(" ")[2])
                    person.done()
                    time.sleep(0.2)  # until the last counts have come
                    print(file=process.stdin, flush=True)
                elif line.startswith(("pose ", "return to the first pose: pose ")):
                    person.do(line)
        except BaseException:
            process.kill()
            raise
        finally:
            patience.cancel()
    assert process.returncode == code, lines
    with capsys.disabled():
        print(f"\n{words[0]}: {time.monotonic() - begin:.1f} s", end="")
    return lines


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_mechanic_from_nothing_to_a_calibrated_rig_in_its_zone(
    whole: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Over a real bus, to a cell in another process. Whole: each cable is checked and two plugs and a sign are found wrong, more poses,
    and places for the points."""
    monkeypatch.chdir(tmp_path)
    said(monkeypatch, capsys, "init", "cell", "--template", "six-cables")
    rig = Path("cell/measured.toml")
    said(monkeypatch, capsys, "drum", "cell/drums.toml", "--rig", "cell/rig.toml", "--out", rig)
    box = "--box=-200:200,-200:200,-200:200"
    said(monkeypatch, capsys, "plan-poses", rig, "--poses", 20 if whole else 9, box, "--further", 0, "--out", "planned.csv")
    bus = {"channel": f"239.74.{random.randrange(1, 255)}.{random.randrange(1, 255)}", "port": random.randrange(20000, 60000)}
    reported = "--bus", f"udp_multicast:{bus['channel']}", "--bus-option", f"port={bus['port']}", "--bus-option", "hop_limit=0"
    nominal = read_rig(rig)
    true = built_like(nominal)
    true = wired_wrongly(true) if whole else true
    (tmp_path / "elsewhere").mkdir()  # the cell's own
    write_rig(tmp_path / "elsewhere" / "rig.toml", true)
    with cell(
        tmp_path, tmp_path / "elsewhere" / "rig.toml", Path("planned.csv"), {"interface": "udp_multicast", "hop_limit": 0, **bus}
    ) as person:
        if whole:
            faults = walked(capsys, person, "check", "--rig", rig, *reported, "--write", "cell/wired.toml", code=1)
            assert sum(line.startswith("fault: ") for line in faults) == 3, "\n".join(faults)
            rig = Path("cell/wired.toml")
            assert walked(capsys, person, "check", "--rig", rig, *reported, "--no-turns")[-1].endswith("at most 0 counts")
        given = "--by", "rest", "--dwell-s", 0.2, "--settle-s", 0.1, "--u-position-mm", 0, "--u-rotation-deg", 0
        lines = walked(capsys, person, "capture", rig, "--poses", "planned.csv", *reported, "--out", "campaign", *given)
    assert any("closed: at most 1.2 counts, which is within rounding" in line for line in lines), "\n".join(lines)
    assert lines[-1] == "next: lmeasure calibrate campaign --out calibrated"
    said(monkeypatch, capsys, "calibrate", "campaign", "--out", "calibrated")
    # lengths over the box, as the built rig has them
    found, rng = read_rig(Path("calibrated/rig.toml")), np.random.default_rng(0)
    turn = read_poses(Path("planned.csv"), nominal.angles).rows[0, 3:]
    rows = np.column_stack([rng.uniform(-150.0, 150.0, (60, 3)), np.tile(turn, (60, 1))])
    error, was = (span_lengths(one, rows) - span_lengths(true, rows) for one in (found, nominal))
    assert np.abs(error - error[0]).max() < 0.1 < 2.0 < np.abs(was - was[0]).max()
    grid = [] if whole else ["--x", "-100:100:50", "--y", "-100:100:50", "--z", "-100:100:50"]
    assert "nodes are in the zone" in said(monkeypatch, capsys, "zone", "calibrated/rig.toml", *grid, "--out", "zone.nc")
    if whole:
        said(monkeypatch, capsys, "place", "calibrated/rig.toml", "--task", "cell/placement.toml", "--generations", 5, "--out", "placed")
        assert "nodes are in the zone" in said(monkeypatch, capsys, "zone", "placed/rig.toml", "--out", "placed.nc")
