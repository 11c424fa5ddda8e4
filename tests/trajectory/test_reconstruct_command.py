"""`lmeasure reconstruct` on real folders: outputs of the contract, and refusals of one line that leave nothing behind."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet
import pytest
import tomli_w
from cells import cell, motion, record
from in_process import ran, refused
from scipy.spatial.transform import Rotation

from lmeasure.core import rotation_from_angles
from lmeasure.recording import write_run
from lmeasure.trajectory import read_trajectory

COLUMNS = ["time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw", "residual_mm", "iterations", "status", "cause", "cable"]
COLUMNS += ["worst_pressure_angle_deg", "u_x_mm", "u_y_mm", "u_z_mm", "u_rx_rad", "u_ry_rad", "u_rz_rad"]
N = 60


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    run = record(cell(), *motion(N))
    run.passes[0].recorded[20:25, 3] = np.nan
    write_run(tmp_path / "run", run)
    return tmp_path / "run"


def test_parquet_and_csv_hold_the_same_to_the_last_bit(folder: Path, tmp_path: Path) -> None:
    for name in ("a.parquet", "a.csv"):
        ran("reconstruct", folder, "--out", tmp_path / name)
    parquet, csv = pd.read_parquet(tmp_path / "a.parquet"), pd.read_csv(tmp_path / "a.csv", keep_default_na=True)
    assert list(parquet.columns)[: len(COLUMNS)] == COLUMNS
    assert list(csv.columns)[: len(COLUMNS)] == COLUMNS
    for column in COLUMNS:
        if parquet[column].dtype.kind in "fi":
            np.testing.assert_array_equal(parquet[column], csv[column])
        else:
            assert list(parquet[column].fillna("")) == list(csv[column].fillna(""))
    assert list(parquet["status"][20:25]) == ["gap"] * 5
    assert parquet.loc[20:24, "x_mm"].isna().all()
    assert list(parquet["cable"][20:25]) == ["c4"] * 5
    a, b = read_trajectory(tmp_path / "a.parquet"), read_trajectory(tmp_path / "a.csv")
    np.testing.assert_array_equal(a.poses, b.poses)
    np.testing.assert_array_equal(a.u, b.u)


def test_the_output_says_what_its_uncertainty_covers(folder: Path, tmp_path: Path) -> None:
    assert "the rig has no linked calibration" in ran("reconstruct", folder, "--out", tmp_path / "a.parquet")
    metadata = pyarrow.parquet.read_schema(tmp_path / "a.parquet").metadata
    assert b"the rig has no linked calibration" in metadata[b"uncertainty_covers"]


def edit(name: str, change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        data = tomllib.loads((folder / name).read_text())
        change(data)
        (folder / name).write_text(tomli_w.dumps(data))

    return apply


def text(name: str, change: Callable[[str], str]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        (folder / name).write_text(change((folder / name).read_text()))

    return apply


def cables(data: dict[str, Any], keep: int) -> None:
    data["cable"] = data["cable"][:keep]


BROKEN: dict[str, tuple[Callable[[Path], None], str]] = {
    "no run.toml": (lambda folder: (folder / "run.toml").unlink(), "run.toml"),
    "no rig": (lambda folder: (folder / "rig.toml").unlink(), "rig.toml"),
    "no counts": (lambda folder: (folder / "pass1.csv").unlink(), "pass1.csv"),
    "run.toml is no TOML": (text("run.toml", lambda s: "start = ["), "TOML"),
    "another schema": (edit("run.toml", lambda d: d.update(schema="lmeasure.run/9")), "lmeasure.run/9"),
    "unknown key": (edit("run.toml", lambda d: d.update(strat={})), "'strat'"),
    "no start": (edit("run.toml", lambda d: d.pop("start")), "[start]"),
    "half a start": (edit("run.toml", lambda d: d["start"].pop("quaternion_xyzw")), "quaternion_xyzw"),
    "start not a unit quaternion": (edit("run.toml", lambda d: d["start"].update(quaternion_xyzw=[0.0, 0.0, 0.0, 2.0])), "length"),
    "start at infinity": (edit("run.toml", lambda d: d["start"].update(position_mm=[0.0, 0.0, float("inf")])), "position_mm"),
    "no pass": (edit("run.toml", lambda d: d.pop("pass")), "[[pass]]"),
    "counts outside the folder": (edit("run.toml", lambda d: d["pass"][0].update(counts="../pass1.csv")), "outside"),
    "a channel is missing": (text("pass1.csv", lambda s: s.replace("ch6", "ch7", 1)), "'ch6'"),
    "a cell is no number": (text("pass1.csv", lambda s: s.replace("\n0.03,", "\n0.03,x", 1)), ":32: ch1: must be a number"),
    "time goes back": (text("pass1.csv", lambda s: s.replace("\n0.03,", "\n0.003,", 1)), "sample 30"),
    "only a header": (text("pass1.csv", lambda s: s.split("\n", maxsplit=1)[0] + "\n"), "no samples"),
    "empty file": (text("pass1.csv", lambda s: ""), "empty"),
    "five cables": (edit("rig.toml", lambda d: cables(d, 5)), "5 cables"),
    "collinear": (edit("rig.toml", lambda d: d["tool"].update(P1=[1.0, 0.0, 0.0], P2=[2.0, 0.0, 0.0], P3=[4.0, 0.0, 0.0])), "line"),
    "start inside a pulley": (edit("run.toml", lambda d: d["start"].update(position_mm=[-754.1, 142.9 + 1e-3, 833.2])), "c1"),
}


@pytest.mark.parametrize("what", list(BROKEN))
def test_a_broken_run_is_one_line_and_no_file(what: str, folder: Path, tmp_path: Path) -> None:
    spoil, hint = BROKEN[what]
    spoil(folder)
    out = tmp_path / "out" / "trajectory.parquet"
    (line,) = refused("reconstruct", folder, "--out", out).splitlines()
    assert hint in line
    assert not out.parent.exists() or not list(out.parent.iterdir())


def test_angles_of_the_rigs_convention_are_added_on_request(folder: Path, tmp_path: Path) -> None:
    ran("reconstruct", folder, "--out", tmp_path / "a.csv", "--angles")
    table = pd.read_csv(tmp_path / "a.csv")
    assert list(table.columns)[-3:] == ["o_deg", "a_deg", "t_deg"]
    known = table["status"] == "ok"
    again = rotation_from_angles("puma-oat", table.loc[known, ["o_deg", "a_deg", "t_deg"]].to_numpy())
    assert (again * Rotation.from_quat(table.loc[known, ["qx", "qy", "qz", "qw"]].to_numpy()).inv()).magnitude().max() < 1e-12
    assert table.loc[~known, "o_deg"].isna().all()


def test_tum_holds_the_known_poses_in_metres(folder: Path, tmp_path: Path) -> None:
    ran("reconstruct", folder, "--out", tmp_path / "a.tum")
    ran("reconstruct", folder, "--out", tmp_path / "a.parquet")
    tum = np.loadtxt(tmp_path / "a.tum")
    table = pd.read_parquet(tmp_path / "a.parquet")
    table = table[table["status"] == "ok"]
    np.testing.assert_array_equal(tum[:, 0], table["time_s"])
    np.testing.assert_array_equal(tum[:, 1:4], table[["x_mm", "y_mm", "z_mm"]] / 1000.0)
    np.testing.assert_array_equal(tum[:, 4:], table[["qx", "qy", "qz", "qw"]])


def test_monte_carlo_by_command(folder: Path, tmp_path: Path) -> None:
    monte_carlo = ["--uncertainty", "monte-carlo", "--trials", "300"]
    assert "by Monte Carlo with 300 trials (JCGM 101)" in ran("reconstruct", folder, "--out", tmp_path / "a.parquet", *monte_carlo)
    ran("reconstruct", folder, "--out", tmp_path / "b.parquet")
    a, b = read_trajectory(tmp_path / "a.parquet"), read_trajectory(tmp_path / "b.parquet")
    np.testing.assert_array_equal(a.poses, b.poses)
    np.testing.assert_allclose(a.u, b.u, rtol=0.25)
    refused("reconstruct", folder, "--out", tmp_path / "a.parquet", "--uncertainty", "guess", code=2)
