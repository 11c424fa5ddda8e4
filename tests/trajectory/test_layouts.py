"""Layouts of other people's tables: read as NumPy wrote them, or refused in one line."""
# ruff: noqa: E501 - a layout is one line

import datetime
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import lmeasure as lm
from lmeasure.core import LMeasureError
from lmeasure.io import columns_of
from lmeasure.trajectory import Stated

FloatArray = NDArray[Any]
TABLES = Path(__file__).parents[1] / "authorities" / "tables"
N = 60
T = np.arange(N) * 0.008
P = np.column_stack([400.0 + 1200.0 * np.sin(0.4 * T), -1100.0 + 90.0 * T**2, 300.0 + 20.0 * T])
"""mm; from 400 to 1000 and beyond, so that thousands have a separator."""
VECTOR = np.column_stack([0.4 + 0.3 * T, 0.3 - 0.2 * T, 0.2 + 0.1 * T])
TURN = Rotation.from_rotvec(VECTOR)
Q = TURN.as_quat()


@dataclass(frozen=True)
class Layout:
    """text or bytes of a file; columns as --columns has them; angles; name: of the file; turned: whether it has orientations; offset_s: of
    its times from T; refused: a pattern of the message; noted: a part of a note."""

    text: str | bytes
    columns: str | None = None
    angles: str | None = None
    name: str = "t.csv"
    turned: bool = True
    offset_s: float = 0.0
    refused: str = ""
    noted: str = ""
    kept: tuple[int, ...] | None = None


def rows(*columns: FloatArray | list[str], mark: str = ",", form: str = ".9f") -> list[str]:
    """Lines of cells."""
    cells = [[c if isinstance(c, str) else format(c, form) for c in column] for column in columns]
    return [mark.join(row) for row in zip(*cells, strict=True)]


def text(header: str, *columns: FloatArray | list[str], mark: str = ",", form: str = ".9f") -> str:
    return "\n".join([*header.split("\n"), *rows(*columns, mark=mark, form=form)]) + "\n"


def comma(values: FloatArray, form: str = ".6f") -> list[str]:
    return [format(v, form).replace(".", ",") for v in values]


def german(values: FloatArray) -> list[str]:
    """1.234,567"""
    return [format(v, ",.6f").replace(",", " ").replace(".", ",").replace(" ", ".") for v in values]


def clock(start: datetime.datetime, form: Callable[[datetime.datetime], str]) -> list[str]:
    return [form(start + datetime.timedelta(microseconds=round(1e6 * t))) for t in T]


MORNING = datetime.datetime(2026, 11, 27, 9, 0, 0)
MIDNIGHT = datetime.datetime(2026, 11, 27, 23, 59, 59, 900000)
X, Y, Z = P.T
DEGREES = {
    "kuka-abc": TURN.as_euler("ZYX", degrees=True),
    "fanuc-wpr": TURN.as_euler("xyz", degrees=True),
    "staubli-xyz": TURN.as_euler("XYZ", degrees=True),
    "zyz": TURN.as_euler("ZYZ", degrees=True),
}
PLAIN = "time=t[s],x=X[mm],y=Y[mm],z=Z[mm]"
TWICE = np.sort(np.append(np.arange(N), 17))

LAYOUTS = {
    "ours": Layout(text("time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw", T, *P.T, *Q.T), noted="quaternion x, y, z, w"),
    "w first": Layout(text("time_s,qw,qx,qy,qz,x_mm,y_mm,z_mm", T, Q[:, 3], *Q.T[:3], *P.T)),
    "metres and milliseconds in headers": Layout(text("t (ms),X [m],y [m],Z (m)", 1e3 * T, *(P.T / 1e3)), turned=False),
    "words for units": Layout(text("Time (Seconds),X [Meters],Y [Millimetres],Z [in]", T, X / 1e3, Y, Z / 25.4), turned=False),
    "microseconds since 1970": Layout(
        text("timestamp [us],x [mm],y [mm],z [mm]", [str(1700000000000000 + round(1e6 * t)) for t in T], *P.T), offset_s=1.7e9, turned=False
    ),
    "a row of units": Layout(text("Time;X;Y;Z\n[ms];[m];[mm];[mm]", 1e3 * T, X / 1e3, Y, Z, mark=";"), turned=False),
    "units named by suffix, mapped": Layout(text("log_ms,tcp_x_m,tcp_y_m,tcp_z_m", 1e3 * T, *(P.T / 1e3)), columns="time=log_ms,x=tcp_x_m,y=tcp_y_m,z=tcp_z_m", turned=False),
    "the header as it is": Layout(text("t [s];X [mm];Y [mm];Z [mm]", comma(T), *map(comma, P.T), mark=";"), columns="time=t [s],x=X [mm],y=Y [mm],z=Z [mm]", turned=False),
    "another unit than the header's": Layout(text("t [s],X [mm],Y [mm],Z [mm]", T, *P.T), columns="time=t[s],x=X[m],y=Y[mm],z=Z[mm]", refused="is in mm by its header, but --columns states m"),
    "decimal commas, tabs, UTF-16": Layout(text("time_s\tx_mm\ty_mm\tz_mm", comma(T), *map(comma, P.T), mark="\t").encode("utf-16"), name="t.txt", turned=False),
    "UTF-16 without a mark": Layout(text("time_s,x_mm,y_mm,z_mm", T, *P.T).encode("utf-16-le"), turned=False),
    "a mark of UTF-8, CRLF": Layout(("\ufeff" + text("time_s,x_mm,y_mm,z_mm", T, *P.T)).replace("\n", "\r\n").encode(), turned=False),
    "German thousands": Layout(text("time_s;x_mm;y_mm;z_mm", german(T), *map(german, P.T), mark=";"), turned=False),
    "English thousands in quotes": Layout(text("time_s,x_mm,y_mm,z_mm", T, *([f'"{v:,.6f}"' for v in c] for c in P.T)), turned=False),
    "Swiss thousands": Layout(text("time_s;x_mm;y_mm;z_mm", T, *([f"{v:,.6f}".replace(",", "'") for v in c] for c in P.T), mark=";"), turned=False),
    "blank thousands": Layout(text("time_s;x_mm;y_mm;z_mm", comma(T), *([f"{v:,.6f}".replace(",", "\u202f").replace(".", ",") for v in c] for c in P.T), mark=";"), turned=False),
    "thousands or decimals": Layout(text("time_s;x_mm;y_mm;z_mm", [str(i) for i in range(N)], ["1,234"] * 30 + ["999"] * 30, *([["5"] * N] * 2), mark=";"), refused="'1,234' may be 1234 or 1.234"),
    "clock times": Layout(text("Uhrzeit;X;Y;Z", clock(MORNING, lambda d: d.strftime("%H:%M:%S,") + f"{d.microsecond // 1000:03d}"), *map(comma, P.T), mark=";"), columns="time=Uhrzeit,x=X[mm],y=Y[mm],z=Z[mm]", offset_s=32400.0, turned=False),
    "over midnight": Layout(text("time,x_mm,y_mm,z_mm", clock(MIDNIGHT, lambda d: d.strftime("%H:%M:%S.%f")), *P.T), offset_s=86399.9, turned=False),
    "half days": Layout(text("time,x_mm,y_mm,z_mm", clock(MORNING.replace(hour=21), lambda d: d.strftime("%m/%d/%Y %I:%M:%S.%f PM")), *P.T), offset_s=75600.0, turned=False),
    "ISO 8601 with a zone": Layout(text("timestamp,x_mm,y_mm,z_mm", clock(MIDNIGHT, lambda d: d.isoformat(timespec="milliseconds") + "+01:00"), *P.T), offset_s=86399.9, turned=False, noted="midnight of 2026-11-27"),
    "ISO 8601 with a blank": Layout(text("time,x_mm,y_mm,z_mm", clock(MORNING, lambda d: d.isoformat(" ", "milliseconds") + "Z"), *P.T), offset_s=32400.0, turned=False),
    "days of two orders": Layout(text("time,x_mm,y_mm,z_mm", [f"0{1 + i % 2}/02/2026 00:00:{i:02d}" for i in range(N)], *P.T), refused="days and months cannot be distinguished"),
    "a commented header": Layout(text("# made by NumPy\n# time_s,x_mm,y_mm,z_mm", T, *P.T), turned=False),
    "a commented header of blanks": Layout(text("% time_s x_mm y_mm z_mm", T, *P.T, mark=" "), name="t.dat", turned=False),
    "numbers alone": Layout(text("0.0,400.0,-1100.0,300.0", T, *P.T), columns="time=0.0[s],x=400.0,y=-1100.0,z=300.0", refused="line 1 contains numbers, and no line above it names"),
    "titles before the header": Layout(text("Project: A\nStation,1\n\ntime_s,x_mm,y_mm,z_mm", T, *P.T), turned=False),
    "an index without a name, columns twice": Layout(text(",time_s,x_mm,y_mm,z_mm,note,note", T, T, *P.T, T, T), turned=False),
    "x twice": Layout(text("time_s,x_mm,x_mm,y_mm,z_mm", T, X, X, Y, Z), refused="column 'x_mm' occurs twice"),
    "TUM in a text file": Layout(text("# timestamp tx ty tz qx qy qz qw", T, *(P.T / 1e3), *Q.T, mark=" "), name="t.txt"),
    "TUM without a header": Layout("\n".join(rows(T, *(P.T / 1e3), *Q.T, mark=" ")) + "\n", name="t.txt"),
    "EuRoC in microseconds": Layout(text("#timestamp [us],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []", 1e6 * T, *(P.T / 1e3), Q[:, 3], *Q.T[:3])),
    "EuRoC under other names": Layout(text("timestamp,p_RS_R_x,p_RS_R_y,p_RS_R_z", T, *P.T), columns="time=timestamp[s],x=p_RS_R_x[mm],y=p_RS_R_y[mm],z=p_RS_R_z[mm]", turned=False),
    "a logger without units": Layout(text("timestamp,x,y,z,qx,qy,qz,qw", T, *(P.T / 1e3), *Q.T), refused="column 'time_s' is missing"),
    "a logger with units": Layout(text("timestamp,x,y,z,qx,qy,qz,qw", 1.7e9 + T, *(P.T / 1e3), *Q.T), columns="time=timestamp[s],x=x[m],y=y[m],z=z[m]", offset_s=1.7e9),
    "a rotation vector": Layout(text("t,X,Y,Z,A,B,C", T, *P.T, *VECTOR.T), columns=f"{PLAIN},rx=A[rad],ry=B[rad],rz=C[rad]", noted="A in rad, B in rad, C in rad: ur-rotation-vector"),
    "a rotation vector in degrees": Layout(text("t,X,Y,Z,A,B,C", T, *P.T, *np.degrees(VECTOR.T)), columns=f"{PLAIN},rx=A[deg],ry=B[deg],rz=C[deg]", angles="ur-rotation-vector"),
    "turns about X, Y, Z in radians": Layout(text("t,X,Y,Z,A,B,C", T, *P.T, *np.radians(DEGREES["staubli-xyz"].T)), columns=f"{PLAIN},rx=A[rad],ry=B[rad],rz=C[rad]", angles="staubli-xyz"),
    "turns without a unit": Layout(text("t,X,Y,Z,A,B,C", T, *P.T, *VECTOR.T), columns=f"{PLAIN},rx=A,ry=B,rz=C", refused="may be angles of staubli-xyz, ur-rotation-vector. Choose one with --angles"),
    "angles of two conventions": Layout(text("time_s,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg,o_deg,t_deg", T, *P.T, *DEGREES["kuka-abc"].T, T, T), refused="may be angles of puma-oat, kuka-abc"),
    "A, B, C": Layout(text("time_s,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg", T, *P.T, *DEGREES["kuka-abc"].T), noted="kuka-abc"),
    "A, B, C in radians": Layout(text("time_s,x_mm,y_mm,z_mm,A,B,C", T, *P.T, *np.radians(DEGREES["kuka-abc"].T)), columns="a=A[rad],b=B[rad],c=C[rad]"),
    "W, P, R": Layout(text("time_s,x_mm,y_mm,z_mm,W [deg],P [deg],R [deg]", T, *P.T, *DEGREES["fanuc-wpr"].T), angles="fanuc-wpr"),
    "angles that nobody names": Layout(text("time_s,x_mm,y_mm,z_mm,Rx [deg],Ry [deg],Rz [deg]", T, *P.T, *DEGREES["staubli-xyz"].T), turned=False, noted="no orientation is read: the columns Rx [deg], Ry [deg], Rz [deg]"),
    "a stamp twice": Layout(text("time_s,x_mm,y_mm,z_mm", T[TWICE], *P[TWICE].T), turned=False, noted="with another pose) and are not used, the first at"),
    "stamps too coarse": Layout(text("time_s,x_mm,y_mm,z_mm", np.floor(T * 50.0) / 50.0, *P.T), refused="the stamps are too coarse"),
    "a time that goes back": Layout(text("time_s,x_mm,y_mm,z_mm", np.where(np.arange(N) == 30, 0.1, T), *P.T), refused="line 32: its time is not after"),
    "empty positions": Layout("time_s,x_mm,y_mm,z_mm\n" + "\n".join(r if i != 7 else f"{T[7]:.9f},,," for i, r in enumerate(rows(T, *P.T))), turned=False, kept=tuple(i for i in range(N) if i != 7)),
    "a row too short": Layout(text("time_s,x_mm,y_mm,z_mm", T, *P.T) + "0.5,1.0\n", refused="has 2 cells"),
    "a bag of ROS 2": Layout(b"SQLite", name="t.db3", refused="mcap convert t.db3 t.mcap"),
    "a bag of ROS 1": Layout(b"#ROSBAG", name="t.bag", refused="mcap convert t.bag t.mcap"),
}  # fmt: skip


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_is_read_right_or_refused(name: str, tmp_path: Path) -> None:
    layout = LAYOUTS[name]
    path = tmp_path / layout.name
    path.write_bytes(layout.text if isinstance(layout.text, bytes) else layout.text.encode())
    if layout.refused:
        with pytest.raises(LMeasureError, match=layout.refused):
            lm.read_trajectory(path, columns=layout.columns, angles=layout.angles)
        return
    read = lm.read_trajectory(path, columns=layout.columns, angles=layout.angles)
    kept = np.arange(N) if layout.kept is None else np.array(layout.kept)
    np.testing.assert_allclose(read.time_s, T + layout.offset_s, rtol=0.0, atol=3e-7 if layout.offset_s > 1e9 else 1e-9)
    np.testing.assert_allclose(read.poses[kept, :3], P[kept], rtol=0.0, atol=2e-6)
    if layout.turned:
        off = (Rotation.from_quat(read.poses[:, 3:]) * TURN.inv()).magnitude()
        assert off.max() < 1e-7
        assert any("orientation read from" in str(note) for note in read.notes)
    else:
        assert np.isnan(read.poses[:, 3:]).all()
    assert layout.noted in " ".join(map(str, read.notes))
    if layout.columns is not None:
        # as the copy in the folder of a certificate is read
        again = lm.read_trajectory(path, Stated(columns_of(layout.columns), angles=layout.angles, of_others=True))
        np.testing.assert_array_equal(again.poses, read.poses)


@pytest.mark.parametrize(
    ("file", "columns", "turned"),
    [
        ("np.csv", None, False),
        ("iso.csv", "time=time[s]", False),
        ("leica.csv", "time=Uhrzeit[s],x=X [mm][mm],y=Y [mm],z=Z [mm]", False),
        ("timestamp.csv", "time=timestamp[s],x=x[m],y=y[m],z=z[m]", True),
        ("motive.csv", None, True),
        ("motive.csv", "time=Time (Seconds)[s],x=X[mm],y=Y[mm],z=Z[mm]", True),
        ("vicon_segments.csv", None, True),
        ("vicon_trajectories.csv", "body=Tool:M1", False),
    ],
)
def test_files_of_other_programs_are_read(file: str, columns: str | None, turned: bool) -> None:
    read = lm.read_trajectory(TABLES / file, columns=columns)
    if columns is not None:
        again = lm.read_trajectory(TABLES / file, Stated(columns_of(columns), of_others=True))
        np.testing.assert_array_equal(again.poses, read.poses)
    atol = 1e-4 if file == "leica.csv" else 2e-6
    assert np.diff(read.time_s)[0] == pytest.approx(0.008, abs=4e-7)
    np.testing.assert_allclose(read.poses[:2, :3], [[400.0, -100.0, 300.0], [401.599932, -100.0128, 300.16]], atol=atol)
    if turned:
        vector = Rotation.from_quat(read.poses[:2, 3:]).as_rotvec()
        np.testing.assert_allclose(vector, [[2.9, 0.0, 0.0], [2.9, 0.0024, 0.0008]], atol=5e-6)
    else:
        assert np.isnan(read.poses[:, 3:]).all()


def test_three_markers_of_nexus_are_a_body() -> None:
    read = lm.read_trajectory(TABLES / "vicon_trajectories.csv")
    middle = np.array([400.0, -100.0, 300.0]) + np.array([50.0, 70.0, 0.0]) / 3.0
    np.testing.assert_allclose(read.poses[0, :3], middle, atol=1e-5)


@pytest.mark.parametrize("wrong", ["body=Tool:M9", "x=Y[mm]"])
def test_a_body_that_is_not_there_is_refused(wrong: str) -> None:
    with pytest.raises(LMeasureError):
        lm.read_trajectory(TABLES / "vicon_trajectories.csv", columns=wrong)


def test_a_table_of_arrow_has_instants(tmp_path: Path) -> None:
    import pandas as pd

    stamps = pd.Timestamp("2026-11-27 09:00:00") + pd.to_timedelta(np.round(1e9 * T).astype(np.int64), "ns")
    pd.DataFrame({"time": stamps, "x_mm": X, "y_mm": Y, "z_mm": Z}).to_parquet(tmp_path / "t.parquet")
    read = lm.read_trajectory(tmp_path / "t.parquet")
    np.testing.assert_allclose(read.time_s, T + 32400.0, atol=1e-9)
