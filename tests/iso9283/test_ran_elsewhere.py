"""Windows of a program from a tracker's file: under its own names, in its own frame, with rows that lie off, or another motion."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from in_process import ran
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray
from lmeasure.recording import Program, read_program

TABLES = Path(__file__).parents[1] / "authorities" / "tables"
RATE_HZ = 125.0
TURNED, MOVED = Rotation.from_euler("xyz", [4.0, -7.0, 60.0], degrees=True), np.array([1500.0, -300.0, 800.0])


def arc(first: FloatArray, via: FloatArray, last: FloatArray) -> FloatArray:
    """(k, 3) points of a circle's piece through three, behind the first."""
    a, b = via - first, last - first
    normal = np.cross(a, b)
    centre = first + np.cross((a @ a) * b - (b @ b) * a, normal) / (2.0 * (normal @ normal))
    x = first - centre
    y = np.cross(normal / np.linalg.norm(normal), x)
    end = np.arctan2((last - centre) @ y, (last - centre) @ x) % (2.0 * np.pi)
    turn = np.linspace(0.0, end, 40)[1:]
    return np.asarray(centre + np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * y)


def robot(slower: float = 1.0) -> tuple[FloatArray, FloatArray, list[tuple[float, float]]]:
    """Times [s] and positions (n, 3) [mm] of a robot that runs commands.csv, each way with a smooth start and stop, and its rests."""
    table = pd.read_csv(TABLES / "commands.csv")
    here, time, times, places, rests = np.array([0.0, 0.0, 25.0]), 1.0, [0.0], [np.array([0.0, 0.0, 25.0])], []
    rows = table[["x_mm", "y_mm", "z_mm"]].to_numpy()
    for number in table["command"].unique():
        own = np.flatnonzero(table["command"] == number)
        points, before = [here[None]], here
        for i in own:
            if table["move"][i] == "arc":
                points.append(arc(before if i - 2 not in own else rows[i - 2], rows[i - 1], rows[i]))
            elif table["move"][i] == "linear":
                points.append(rows[i][None])
        line = np.vstack(points)
        arcs = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        lasts = slower * arcs[-1] / table["speed_mm_s"][own[0]] + 0.3
        share = np.linspace(0.0, 1.0, 200)
        smooth = share - np.sin(2.0 * np.pi * share) / (2.0 * np.pi)
        times += list(time + lasts * share)
        places += list(np.column_stack([np.interp(smooth * arcs[-1], arcs, line[:, k]) for k in range(3)]))
        time, here = time + lasts, rows[own[-1]]
        dwell = float(table["dwell_s"][own[-1]])
        if dwell:
            rests.append((time, time + dwell))
            time += dwell
            times.append(time)
            places.append(here)
    t = np.arange(0.0, time + 1.0, 1.0 / RATE_HZ)
    at = np.array(times)
    p = np.column_stack([np.interp(t, at, np.array(places)[:, k]) for k in range(3)])
    return t, p + np.random.default_rng(0).normal(0.0, 0.01, p.shape), rests


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("commands.csv", "program.toml"):
        (tmp_path / name).write_bytes((TABLES / name).read_bytes())
    return tmp_path


def driven(folder: Path, t: FloatArray, p: FloatArray, *more: str) -> tuple[Program, str]:
    pd.DataFrame({"time_s": t, "x_mm": p[:, 0], "y_mm": p[:, 1], "z_mm": p[:, 2]}).to_csv(folder / "t.csv", index=False)
    return filled(folder, "t.csv", *more)


def filled(folder: Path, name: str, *more: str) -> tuple[Program, str]:
    said = ran("program", "--out", folder, "--ran", folder / name, *more)
    return read_program(folder / "program.toml"), said


def right(program: Program, rests: list[tuple[float, float]], within_s: float = 0.15) -> None:
    """Windows of poses lie in the rests of their commands, windows of paths between those before and behind."""
    table = pd.read_csv(TABLES / "commands.csv")
    ends = table.groupby("command").last()
    dwells = ends[ends["dwell_s"] > 0]
    of: dict[str, list[int]] = {}
    for k, target in enumerate(dwells["target"]):
        of.setdefault(target, []).append(k)
    for pose in program.pose:
        assert len(pose.windows_s) == len(of[pose.name])
        for (start, end), k in zip(pose.windows_s, of[pose.name], strict=True):
            assert rests[k][0] <= start < end <= rests[k][1] + 0.05
    for path in program.path:
        assert len(path.windows_s) == len(of[path.name])
        for (start, end), k in zip(path.windows_s, of[path.name], strict=True):
            assert start == pytest.approx(rests[k - 1][1], abs=within_s)
            assert end == pytest.approx(rests[k][0], abs=within_s)


def two_rows_off(t: FloatArray, p: FloatArray, rests: list[tuple[float, float]]) -> None:
    """Two samples 0.4 mm off in every rest."""
    for start, end in rests:
        i = int(np.searchsorted(t, 0.6 * start + 0.4 * end))
        p[i : i + 2, 1] += 0.4


@pytest.mark.parametrize("change", [None, two_rows_off])
def test_windows_are_those_of_the_commands(folder: Path, change: Callable[..., None] | None) -> None:
    t, p, rests = robot()
    if change is not None:
        change(t, p, rests)
    program, _ = driven(folder, t, p)
    right(program, rests)


def test_a_trackers_own_names_and_units(folder: Path) -> None:
    t, p, rests = robot()
    mapping = "time=Zeit[s],x=X[m],y=Y[m],z=Z[m],qw=Q0,qx=Q1,qy=Q2,qz=Q3"
    cells = np.column_stack([t, p / 1e3, np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1))])
    lines = [";".join(f"{v:.7f}" for v in row).replace(".", ",") for row in cells]
    (folder / "trk_de.csv").write_text("\n".join(["Zeit;X;Y;Z;Q0;Q1;Q2;Q3", *lines]) + "\n")
    program, _ = filled(folder, "trk_de.csv", "--columns", mapping)
    right(program, rests)


def test_a_certificate_in_three_commands_from_a_trackers_own_frame(folder: Path) -> None:
    t, p, rests = robot()
    seen = np.asarray(TURNED.apply(p) + MOVED)
    with pytest.raises(AssertionError, match="Is the trajectory in another frame \\(--align\\)"):
        driven(folder, t, seen)
    quaternion = np.tile(TURNED.as_quat(), (len(t), 1))
    columns = {name: seen[:, k] for k, name in enumerate(("x_mm", "y_mm", "z_mm"))} | dict(
        zip(("qx", "qy", "qz", "qw"), quaternion.T, strict=True)
    )
    pd.DataFrame({"time_s": t} | columns).to_csv(folder / "t.csv", index=False)
    program, _ = filled(folder, "t.csv", "--align")
    right(program, rests)
    words = ["certify", str(folder / "t.csv"), "--program", str(folder / "program.toml"), "--align", "--trials", "100"]
    ran(*words, "--u-position-mm", "0.01", "--u-rotation-deg", "0.01", "--out", folder / "c")
    assert "orientation read from qx, qy, qz, qw: quaternion x, y, z, w" in (folder / "c" / "certificate.json").read_text()
    ran("motion", folder / "t.csv", "--align", folder / "program.toml", "--out", folder / "m.csv")
    moved = pd.read_csv(folder / "m.csv")
    inside = moved["time_s"].between(rests[0][0] + 0.3, rests[0][1] - 0.3)
    first = pd.read_csv(TABLES / "commands.csv")[["x_mm", "y_mm", "z_mm"]].to_numpy()[0]
    np.testing.assert_allclose(moved.loc[inside, ["x_mm", "y_mm", "z_mm"]].mean(), first, atol=0.02)
    np.testing.assert_allclose(np.abs(moved.loc[inside, "qw"]), 1.0, atol=1e-3)


def test_positions_alone_are_certified_in_their_own_frame(folder: Path) -> None:
    t, p, _ = robot()
    results = {}
    for name, positions, own in (("base", p, ()), ("seen", np.asarray(TURNED.apply(p) + MOVED), ("--align",))):
        (folder / name).mkdir()
        for file in ("program.toml", "commands.csv"):
            (folder / name / file).write_bytes((folder / file).read_bytes())
        table = folder / f"{name}.csv"
        pd.DataFrame({"time_s": t, "x_mm": positions[:, 0], "y_mm": positions[:, 1], "z_mm": positions[:, 2]}).to_csv(table, index=False)
        said = ran("program", "--out", folder / name, "--ran", table, *own)
        assert all(word in said for word in own), said  # the next command is one that can be copied
        words = ["certify", table, "--program", folder / name / "program.toml", "--align", "--trials", "100", "--u-position-mm", "0.01"]
        ran(*words, "--out", folder / f"c-{name}")
        found = json.loads((folder / f"c-{name}" / "certificate.json").read_text())["characteristics"]
        results[name] = {(c["name"], c["pose"]): (c["value"], c["u95"]) for c in found if "pose" in c}
    assert results["base"].keys() == results["seen"].keys() >= {("AP_p", "P1"), ("RP_l", "P5")}
    for key, (value, u95) in results["base"].items():
        if key[0] in ("AP_p", "RP_l"):  # the same in every frame
            assert results["seen"][key] == (pytest.approx(value, abs=1e-3), pytest.approx(u95, rel=0.4)), key


def test_the_pace_of_a_run_is_reported(folder: Path) -> None:
    t, p, rests = robot(slower=3.0)
    program, said = driven(folder, t, p)
    right(program, rests, within_s=0.5)
    assert "% of the commanded speeds" in said


def test_what_was_not_run_is_named(folder: Path) -> None:
    """Without the samples of a circle its end is no rest of its own; without the end of the run the last command has none."""
    t, p, rests = robot()
    table = pd.read_csv(TABLES / "commands.csv")
    dwells = table.groupby("command").last()
    dwells = dwells[dwells["dwell_s"] > 0]
    k = next(i for i, name in enumerate(dwells["target"]) if name == "large circle")
    kept = (t < rests[k - 1][1] - 0.2) | (t > rests[k][0] + 0.2)
    with pytest.raises(AssertionError, match=r"command \d+ \(large circle, cycle \d\): (no rest near|the rest near .* is not its own)"):
        driven(folder, t[kept], p[kept])
    with pytest.raises(AssertionError, match=r"command \d+ \(.*\): no rest near"):
        driven(folder, t[t < rests[-1][0] - 0.5], p[t < rests[-1][0] - 0.5])
