"""Zones of rigs with encoders, and which faults would show: against generalised least squares written out, with faults put in by hand."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from in_process import ran, refused
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from lmeasure.accuracy import Placement, Scan, exact_radius_95, guard, map_zone, tilts
from lmeasure.accuracy.placement import Search, Where, Work
from lmeasure.accuracy.readings import worst_figures
from lmeasure.accuracy.scan import Plan, run
from lmeasure.accuracy.zone import make_plan
from lmeasure.core import AccuracyError, FloatArray, RigError
from lmeasure.kernels import BASE, BODY_COLUMNS, LONGEST, SHORTEST, SPEED2, U95_POSITION
from lmeasure.recording import Program
from lmeasure.rig import Rig, read_rig, rig_from_dict

AUTHORITY = Path(__file__).parent.parent / "authorities" / "truth"
PLACE = np.array([80.0, -60.0, 40.0])
TURN = Rotation.from_rotvec([0.1, -0.05, 0.08])
SHIFT = float(norm.isf(0.0005) + norm.ppf(0.8))


def mixed() -> Rig:
    """Five cables, three swivels of which the zero of one is known badly, and an inclinometer."""
    data = read_rig(AUTHORITY / "swivel-run" / "rig.toml").to_dict()
    data["cable"], data["observation_point"] = data["cable"][:5], data["observation_point"][:5]
    data["swivel"] = data["swivel"][:3]
    data["swivel"][1]["u_zero_deg"] = 0.004
    data["inclination"] = [{"channel": "level", "axis": [1.0, 0.2, 0.1], "counts_per_revolution": 3600000, "zero_deg": 0.0}]
    return rig_from_dict(data)


def readings(rig: Rig, x: FloatArray) -> FloatArray:
    """What channels read at a place x[:3] and the orientation Exp(x[3:]) TURN, by the definitions (docs/sensors.md, docs/method.md)."""
    turn = Rotation.from_rotvec(x[3:]) * TURN
    points = {p.name: p for p in rig.observation_point}
    out = []

    def seen(name: str, to: str) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        p = points[name]
        a, b = np.radians([p.guide_alpha_deg, p.guide_beta_deg])
        u = np.array([-np.cos(a) * np.sin(b), -np.cos(a) * np.cos(b), np.sin(a)])
        e0 = np.array([np.sin(a) * np.sin(b), np.sin(a) * np.cos(b), np.cos(a)])
        return x[:3] + turn.apply(rig.tool[to]) - np.array(p.position_mm), u, e0, np.cross(u, e0)

    for c in rig.cable:
        d, u, _, _ = seen(c.from_point, c.to_point)
        radius = points[c.from_point].pulley_radius_mm
        q, p = d @ u, np.linalg.norm(d - (d @ u) * u)
        t = np.sqrt(q**2 + (p - radius) ** 2 - radius**2)
        out.append(radius * np.arctan2(q * radius + (p - radius) * t, q * t - (p - radius) * radius) + t)
    for s in rig.swivel:
        to = next(c.to_point for c in rig.cable if c.from_point == s.point)
        d, _, e0, e1 = seen(s.point, to)
        out.append(np.arctan2(d @ e1, d @ e0))
    for i in rig.inclination:
        axis = turn.apply(np.array(i.axis) / np.linalg.norm(i.axis))
        out.append(np.arctan2(axis[2], np.hypot(axis[0], axis[1])))
    return np.array(out)


def stated(rig: Rig) -> tuple[FloatArray, FloatArray]:
    """Rows by differences, and variances of the readings: counts, and the zero of each."""
    steps = np.r_[[1e-4] * 3, [1e-7] * 3]
    x = np.r_[PLACE, 0.0, 0.0, 0.0]
    A = np.column_stack([(readings(rig, x + h * e) - readings(rig, x - h * e)) / (2 * h) for h, e in zip(steps, np.eye(6), strict=True)])
    cable = [2.0 * 0.012**2 / 12.0] * len(rig.cable)
    angle = [
        (2 * np.pi / e.counts_per_revolution) ** 2 / 12.0 + np.radians(e.u_zero_deg or 0.0) ** 2 for e in (*rig.swivel, *rig.inclination)
    ]
    return A, np.array([*cable, *angle])


def at_place(rig: Rig, turn: Rotation = TURN, reliability: bool = True) -> xr.Dataset:
    nodes = np.array(PLACE[:1]), np.array(PLACE[1:2]), np.array(PLACE[2:])
    return map_zone(rig, None, nodes, Rotation.from_quat([turn.as_quat()]), scan=Scan(full=True, reliability=reliability)).isel(
        x=0, y=0, z=0
    )


def test_a_place_is_told_by_all_channels() -> None:
    rig = mixed()
    A, variance = stated(rig)
    C = np.linalg.inv(A.T @ (A / variance[:, None]))
    moves, turns = (np.asarray(np.linalg.eigvalsh(part), dtype=np.float64) for part in (C[:3, :3], C[3:, 3:]))
    zone = at_place(rig)
    assert float(zone.u95_position_mm) == pytest.approx(exact_radius_95(moves), rel=1e-4)
    assert np.radians(float(zone.u95_rotation_deg)) == pytest.approx(exact_radius_95(turns), rel=1e-4)
    # an encoder that tells nothing more than is known of its zero adds nothing: as if it were not there
    data = rig.to_dict()
    del data["swivel"][1]["zero_deg"], data["swivel"][1]["u_zero_deg"]
    unknown = at_place(rig_from_dict(data), reliability=False)
    without = at_place(rig_from_dict(data | {"swivel": [data["swivel"][0], data["swivel"][2]]}), reliability=False)
    assert float(unknown.u95_position_mm) == pytest.approx(float(without.u95_position_mm), rel=1e-5)
    assert float(unknown.u95_position_mm) > 1.0001 * float(zone.u95_position_mm)


def test_a_pressure_angle_is_geometry_whatever_is_known_of_zeros() -> None:
    rig = mixed()
    A, _ = stated(rig)
    moves, turns = A[:, :3], A[:, 3:]
    arms = [TURN.apply(rig.tool[c.to_point]) for c in rig.cable] + [TURN.apply(rig.tool[rig.cable[i].to_point]) for i in range(3)]
    # an angle in the length by which its point is seen, or that of the tool's size
    size = max(float(np.linalg.norm(p)) for p in rig.tool.values())
    seen = np.r_[np.ones(5), np.linalg.norm(moves[5:8], axis=1), 1.0 / size]
    G = np.linalg.pinv(np.column_stack([moves, turns]) / seen[:, None]) / seen
    speeds = [np.linalg.norm(G[:3, j] + np.cross(G[3:, j], arms[j])) * seen[j] for j in range(8)]
    expected = np.degrees(np.arccos(1.0 / max(1.0, *speeds, float(np.linalg.norm(G[3:, 8])))))
    data, u95 = rig.to_dict(), []
    for u_zero in (0.0, 0.03, 2.0):
        data["swivel"] = [e | {"u_zero_deg": u_zero} for e in data["swivel"]]
        zone = at_place(rig_from_dict(data), reliability=False)
        assert float(zone.worst_pressure_angle_deg) == pytest.approx(expected, abs=1e-3)
        u95.append(float(zone.u95_position_mm))
    assert u95[0] < u95[1] < u95[2]


@pytest.mark.parametrize("made", [mixed, lambda: read_rig(AUTHORITY / "eight-run" / "rig.toml")])
def test_faults_put_in_by_hand_show_as_the_map_says(made: object) -> None:
    rig = made()  # type: ignore[operator]
    A, variance = stated(rig)
    zone = at_place(rig)
    m, P = len(variance), np.diag(1.0 / variance)
    unit = np.where(zone.channel_unit.values == "degree", np.pi / 180.0, 1.0)

    def left(fault: FloatArray, kept: list[int]) -> tuple[float, FloatArray]:
        """Chi-squared of what least squares leaves of a fault, by these readings, and where it puts the tool."""
        J, W = A[kept], P[np.ix_(kept, kept)]
        moved: FloatArray = np.asarray(np.linalg.solve(J.T @ W @ J, J.T @ W @ fault[kept]), dtype=np.float64)
        rest = fault[kept] - J @ moved
        return float(rest @ W @ rest), np.asarray(moved[:3])

    every = list(range(m))
    for j in range(m):
        fault = np.zeros(m)
        fault[j] = float(zone.least_fault.values[j]) * unit[j]
        shown, moved = left(fault, every)
        assert shown == pytest.approx(SHIFT**2, rel=1e-4)
        assert np.linalg.norm(moved) == pytest.approx(float(zone.fault_effect_mm.values[j]), rel=1e-4)
        # found whichever other channel is left out; with the one that is most alike just so
        apart = float(zone.least_fault_apart.values[j])
        fault *= apart / float(zone.least_fault.values[j]) if np.isfinite(apart) else 1e3
        least = min(left(fault, [k for k in every if k != other])[0] for other in every if other != j)
        if np.isfinite(apart):
            assert least == pytest.approx(SHIFT**2, rel=1e-2)
        else:
            assert least < SHIFT**2


def test_six_channels_tell_a_pose_and_no_fault() -> None:
    rig = read_rig(AUTHORITY / "swivel-three" / "rig.toml")
    nodes, turns = (np.array([-100.0, 0.0, 100.0]), np.zeros(1), np.zeros(1)), tilts(0.1, 3)
    zone = map_zone(rig, None, nodes, turns)
    assert np.isfinite(zone.u95_position_mm).all()
    assert "assembly" not in zone
    # chunks, threads and the rows by themselves give the same bits
    plan = make_plan(
        rig, None, np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 3), turns, start=np.r_[0.0, 0, 0, 0, 0, 0, 1]
    )
    figures = [run(one, workers=2)[0] for one in (plan, Plan(**{**vars(plan), "nodes_per_chunk": 1}))]
    np.testing.assert_array_equal(figures[0], figures[1])
    with pytest.raises(AccuracyError, match="six channels for six unknowns"):
        map_zone(rig, None, nodes, turns, scan=Scan(reliability=True))
    data = rig.to_dict()
    with pytest.raises(RigError, match=r"has 5 channels. A pose needs at least 6"):
        map_zone(rig_from_dict(data | {"swivel": data["swivel"][:2]}), None, nodes, turns)


def test_places_are_judged_by_all_channels() -> None:
    """And a swivel goes with its point."""
    rig = mixed()
    low, high = (-80.0, -60.0, 0.0), (80.0, 60.0, 0.0)
    task = Work(low_mm=low, high_mm=high, nodes=2, tilt_rad=0.1)
    box = Where(points=("B1",), low_mm=(-900.0, 300.0, 700.0), high_mm=(-800.0, 500.0, 900.0))
    search = Search(rig, Placement.model_validate({"schema": "lmeasure.placement/1", "task": task, "mount": (box,)}))
    moved = search.current() + [40.0, 30.0, -20.0]
    for x in (search.current(), moved):
        found = search.figures(x[None])[0]
        rows = search.channels(x[None])[0]
        assert search.plan.channels is not None
        nodes = np.array([(a, b, 0.0) for a in (low[0], high[0]) for b in (low[1], high[1])])
        empty: dict[str, Any] = {"points": np.empty((0, 3)), "pairs": np.empty((0, 2), np.int64), "bodies": np.empty((0, BODY_COLUMNS))}
        figures, _ = worst_figures(replace(search.plan.channels, rows=rows), nodes, search.plan.quaternions, **empty)
        expected = figures[SPEED2].max(), figures[U95_POSITION].max(), figures[SHORTEST].min(), figures[LONGEST].max()
        np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert rows[5, BASE] == rows[0, BASE] == moved[0]


def test_the_command_maps_faults_and_guards_a_program(tmp_path: Path) -> None:
    rig, out = AUTHORITY / "swivel-run" / "rig.toml", tmp_path / "zone.nc"
    box = ["--x", "-100:100:100", "--y", "0:100:100", "--z", "0:0:1", "--tilt-rad", "0.1"]
    words = ["zone", str(rig), *box, "--reliability", "--report", str(tmp_path), "--out", str(out), "--language", "ru"]
    done = ran(*words)
    zone = xr.load_dataset(out, engine="h5netcdf")
    assert zone.least_fault.dims == ("x", "y", "z", "channel")
    assert zone.channel.values.tolist()[5:7] == ["c6", "sw1"]
    assert zone.channel_unit.values.tolist()[5:7] == ["mm", "degree"]
    assert (zone.least_fault_apart >= zone.least_fault).all()
    assert "sw6: " in done
    assert "Обнаруживаемые ошибки" in (tmp_path / "zone.html").read_text(encoding="utf-8")
    pose = {"name": "P1", "position_mm": (0.0, 50.0, 0.0), "quaternion_xyzw": (0.0, 0.0, 0.0, 1.0), "windows_s": ()}
    program = Program.model_validate({"schema": "lmeasure.program/1", "pose": [pose]})
    (part,) = guard(read_rig(rig), None, zone, program, rotation=Rotation.identity())
    assert 0.005 < part.u95_mm[0] < 0.02
    assert "encoders" in refused("zone", rig, *box, "--boundary", "--out", tmp_path / "b.nc")
