"""Lengths: from counts with signs, scales and drums undone, several passes on one time base, and back to counts."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import oracles
import pytest
import test_rig

import lmeasure as lm
from lmeasure.core import FileFormatError, FloatArray, GeometryError, Status
from lmeasure.kernels import PARAMETERS
from lmeasure.recording import Counts, Run
from lmeasure.rig import CalibrationRecord, Rig, parameter_names, rig_from_dict
from lmeasure.sensors import (
    Lengths,
    cable_covariance,
    changes_from_counts,
    count_variance,
    counts_from_poses,
    length_residuals,
    lengths_from_counts,
    read_lengths,
    recorded_from_counts,
    span_lengths,
    write_lengths,
)
from lmeasure.simulation import cell_rig

HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])


def rig(**drum: Any) -> Rig:
    d = test_rig.data()
    for point in d["observation_point"]:
        point["drum"] |= drum
    return rig_from_dict(d)


def oracle_cables(of: Rig) -> list[oracles.Cable]:
    """The rig's cables in the oracle's words."""
    out = []
    for c in of.cable:
        p = of.point(c.from_point)
        out.append(
            oracles.Cable(
                base=p.position_mm, alpha=math.radians(p.guide_alpha_deg), beta=math.radians(p.guide_beta_deg), radius=p.pulley_radius_mm,
                attachment=of.tool[c.to_point], tangent=p.drum.tangent_length_mm, axial=p.drum.axial_offset_mm,
                pitch=p.drum.groove_pitch_mm, counts_per_revolution=p.drum.counts_per_revolution, count_length=p.drum.count_length_mm,
                scale=p.drum.scale,
            )
        )  # fmt: skip
    return out


def clock(n: int, step: float = 1e-3, begin: float = 0.0) -> FloatArray:
    return np.asarray(begin + np.arange(n) * step, dtype=np.float64)


def run_of(recorded: FloatArray, of: Rig | None = None, time_s: FloatArray | None = None) -> Run:
    """A run of two passes: channels ch1, ch2 in pass 1 and ch1 in pass 2."""
    t = clock(len(recorded)) if time_s is None else time_s
    first = Counts(t, ("ch1", "ch2"), recorded[:, :2], source="pass1.csv")
    second = Counts(t, ("ch1", "ch2"), np.column_stack([recorded[:, 2], np.zeros(len(t))]), source="pass2.csv")
    return Run(of or rig(), HOME, (first, second), unstated="exact")


def test_counts_and_poses_agree_with_the_string_oracle() -> None:
    r = rig()
    pose = oracles.compose(HOME, [0.1, -0.2, 0.3], [50.0, 60, -40])
    counts = counts_from_poses(r, pose[None], HOME)[0]
    for k, c in zip(counts, oracle_cables(r), strict=True):
        change = float(oracles.free_length(c, pose) - oracles.free_length(c, HOME))
        assert float(oracles.drum_change(k, c)) == pytest.approx(change, abs=1e-10)
    lengths = [float(oracles.free_length(c, pose)) for c in oracle_cables(r)]
    assert span_lengths(r, pose[None])[0] == pytest.approx(lengths, abs=1e-11)


def test_there_and_back_through_the_counters() -> None:
    """Poses -> counts -> what the encoders record (sign, scale, rounding) -> changes: within half a recorded count."""
    r = rig(counter_bits=16)
    g = np.random.default_rng(1)
    path = np.cumsum(g.normal(0, 0.3, (3000, 3)), axis=0)
    poses = np.column_stack([path, np.zeros((3000, 3)), np.ones(3000)])
    counts = counts_from_poses(r, poses, HOME)
    assert np.abs(counts).max() > 1000
    lengths = lengths_from_counts(run_of(recorded_from_counts(r, counts), r))
    assert (lengths.flags == Status.OK).all()
    truth = span_lengths(r, poses) - span_lengths(r, HOME[None])
    half = np.array([r.point(c.from_point).drum.count_length_mm / r.point(c.from_point).drum.scale / 2 for c in r.cable])
    assert (np.abs(lengths.change_mm - truth) <= half * 1.02).all()
    assert changes_from_counts(r, counts) == pytest.approx(truth, abs=1e-9)
    assert np.abs(length_residuals(run_of(recorded_from_counts(r, counts), r), poses)).max() <= half.max() * 1.02


def test_recorded_counts_by_hand() -> None:
    """ch2: count_sign -1, scale 0.5."""
    r = rig(counter_bits=16)
    assert recorded_from_counts(r, np.array([[40_000.0, 101, -40_000]])).tolist() == [[40_000 - 65_536, -50, 65_536 - 40_000]]
    lengths = lengths_from_counts(run_of(np.array([[7.0, -50, 0]])))
    assert lengths.counts.tolist() == [[7, 100, 0]]
    drums = oracle_cables(rig())
    assert lengths.change_mm[0] == pytest.approx([float(oracles.drum_change(k, c)) for k, c in zip((7, 100, 0), drums, strict=True)])


def test_variance_of_a_whole_count() -> None:
    assert count_variance(rig()) == pytest.approx([0.012**2 / 12, (0.02 / 0.5) ** 2 / 12, 0.012**2 / 12])


def test_reasons_name_the_cable() -> None:
    recorded = np.zeros((12, 3))
    recorded[2, 1] = np.nan
    recorded[4, 0] = 50_000
    recorded[6, 2] = 50_000
    recorded[8] = np.nan
    lengths = lengths_from_counts(run_of(recorded))
    assert lengths.flags.tolist() == [0, 0, Status.GAP, 0, Status.JUMP, 0, Status.JUMP, 0, Status.GAP, 0, 0, 0]
    assert [lengths.cable[i] for i in (2, 4, 6, 8)] == ["c2", "c1", "c3", "c1"]
    assert str(lengths.cause[2]) == "channel ch2 has no count"
    assert str(lengths.cause[4]) == "channel ch1 jumped faster than max_cable_speed_mm_s = 20000 allows"
    assert str(lengths.cause[0]) == ""
    assert np.isnan(lengths.change_mm[2, 1])
    assert lengths.notes == ()


def test_an_inferred_width_is_noted() -> None:
    """B2's counter_bits is not stated; it is at half scale and runs backwards."""
    k = np.zeros((100, 3))
    k[:, 1] = np.arange(100.0) * 400
    shown = (k + 2**15) % 2**16 - 2**15
    lengths = lengths_from_counts(run_of(shown))
    assert lengths.counts[:, 1] == pytest.approx(-2 * k[:, 1])
    assert "pass1.csv: counter_bits of channel ch2 is not stated. 16 bits are assumed from its jumps" in map(str, lengths.notes)


def test_a_foreign_value_and_an_unsure_counter() -> None:
    r = rig(counter_bits=16, max_cable_speed_mm_s=20000.0)
    recorded = np.zeros((6, 3))
    recorded[2, 0] = 70_000
    t = np.array([0, 0.001, 0.002, 0.003, 0.003 + 0.04, 0.044])
    lengths = lengths_from_counts(run_of(recorded, r, t))
    assert lengths.flags.tolist() == [0, 0, Status.JUMP, 0, Status.GAP, Status.GAP]
    assert "has a value outside a 16-bit counter" in str(lengths.cause[2])
    assert "may have wrapped undetected at max_cable_speed_mm_s = 20000" in str(lengths.cause[4])


def test_passes_are_brought_to_the_first_one_s_instants() -> None:
    """Pass 2 has instants of its own on the same clock: lines join its samples, and nothing is said beyond them."""
    t1, t2 = clock(100), clock(120, 0.7e-3, 0.0083)

    def motion(t: FloatArray) -> FloatArray:
        return 20_000 * t + 300

    first = Counts(t1, ("ch1", "ch2"), np.zeros((100, 2)))
    second = Counts(t2, ("ch1", "ch2"), np.column_stack([motion(t2), np.zeros(120)]))
    lengths = lengths_from_counts(Run(rig(), HOME, (first, second), unstated="exact"))
    inside = (t1 >= t2[0]) & (t1 <= t2[-1])
    assert 80 < inside.sum() < 100
    assert lengths.counts[inside, 2] == pytest.approx(motion(t1)[inside], abs=1e-6)
    assert (lengths.flags[~inside] == Status.GAP).all()
    assert set(map(str, lengths.cause[~inside])) == {"pass 2 does not cover this time"}
    assert set(lengths.cable[~inside]) == {"c3"}


def test_a_hole_in_a_later_pass_is_not_filled() -> None:
    t1, t2 = clock(100), clock(200, 0.5e-3, 0.2e-3)
    keep = (t2 < 0.03) | (t2 > 0.06)
    first = Counts(t1, ("ch1", "ch2"), np.zeros((100, 2)))
    second = Counts(t2[keep], ("ch1", "ch2"), np.zeros((keep.sum(), 2)))
    lengths = lengths_from_counts(Run(rig(), HOME, (first, second), unstated="exact"))
    assert lengths.flags[0] == Status.GAP
    assert str(lengths.cause[0]) == "pass 2 does not cover this time"
    hole = (t1 > t2[t2 < 0.03].max()) & (t1 < t2[t2 > 0.06].min())
    assert (lengths.flags[hole] == Status.GAP).all()
    assert set(map(str, lengths.cause[hole])) == {"pass 2 has no samples near this time"}
    assert (lengths.flags[1:][~hole[1:]] == Status.OK).all()
    assert np.isnan(lengths.counts[hole, 2]).all()


def test_samples_beside_a_gap_of_a_later_pass() -> None:
    t = clock(20)
    first = Counts(t, ("ch1", "ch2"), np.zeros((20, 2)))
    values = np.zeros((20, 2))
    values[5, 0] = np.nan
    at_once = lengths_from_counts(Run(rig(), HOME, (first, Counts(t, ("ch1", "ch2"), values)), unstated="exact"))
    assert np.flatnonzero(at_once.flags).tolist() == [5]
    between = lengths_from_counts(Run(rig(), HOME, (first, Counts(t + 0.5e-3, ("ch1", "ch2"), values)), unstated="exact"))
    assert np.flatnonzero(between.flags).tolist() == [0, 5, 6]
    alone = lengths_from_counts(Run(rig(), HOME, (first, Counts(t[:1], ("ch1", "ch2"), np.zeros((1, 2)))), unstated="exact"))
    assert (alone.flags == Status.OK).tolist() == [True] + [False] * 19


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_lengths_come_back_bit_for_bit(tmp_path: Path, suffix: str) -> None:
    g = np.random.default_rng(3)
    recorded = np.rint(np.cumsum(g.normal(0, 100, (50, 3)), axis=0))
    recorded[7, 1] = np.nan
    recorded[20, 0] += 60_000
    lengths = lengths_from_counts(run_of(recorded))
    path = tmp_path / f"lengths{suffix}"
    write_lengths(path, lengths)
    back = read_lengths(path)
    assert back.cables == lengths.cables
    for name in ("time_s", "change_mm", "counts"):
        assert np.array_equal(getattr(back, name), getattr(lengths, name), equal_nan=True)
    assert np.array_equal(back.flags, lengths.flags)
    assert list(map(str, back.cause)) == list(map(str, lengths.cause))
    assert back.cable.tolist() == lengths.cable.tolist()
    assert isinstance(back, Lengths)


def test_what_is_no_lengths_file(tmp_path: Path) -> None:
    path = tmp_path / "l.csv"
    path.write_text("time_s,c1_mm,c1_count,status,cause,cable\n0,1,2,fine,,\n")
    with pytest.raises(FileFormatError, match=r":2: status: 'fine' is not one of ok, singular"):
        read_lengths(path)
    path.write_text("time_s\n0\n")
    with pytest.raises(FileFormatError, match="has no column <cable>_mm"):
        read_lengths(path)


def test_a_cable_that_cannot_run_is_named() -> None:
    on_axis = np.r_[159.05, -1642.2, 1381.81, 0, 0, 0, 1.0]
    d = test_rig.data()
    d["tool"]["P1"] = [0, 0, 0]
    with pytest.raises(GeometryError, match="pose 2: cable c1: P1 lies on the axis of B1 or inside its pulley"):
        span_lengths(rig_from_dict(d), np.array([HOME, on_axis]))


def test_a_missing_channel_is_named() -> None:
    run = run_of(np.zeros((3, 3)))
    bare = replace(run.passes[0], channels=("ch1", "other"))
    with pytest.raises(FileFormatError, match=r"pass1.csv: column 'ch2' is missing. It has ch1, other"):
        lengths_from_counts(Run(run.rig, run.start, (bare, run.passes[1]), unstated="exact"))


def test_covariance_in_the_kernels_units_and_order() -> None:
    """Cables that share a point share its errors; angles come in radians; what was not solved is exact."""
    names = ["B1.x_mm", "B1.guide_alpha_deg", "B2.scale", "tool.P1.z_mm"]
    u = np.array([2.0, 0.5, 1e-3, 0.1])
    covariance = np.diag(u**2)
    covariance[0, 1] = covariance[1, 0] = 0.3 * u[0] * u[1]
    record = CalibrationRecord.model_validate(
        {
            "rig": "demo", "parameters": [{"name": n, "value": 0.0, "u": x, "prior_u": 1.0} for n, x in zip(names, u, strict=True)],
            "covariance": covariance.tolist(), "residuals": [], "equations": 4, "unknowns": 4, "rank": 4,
        }
    )  # fmt: skip
    r = rig()
    flat = [(j, name) for j in range(3) for name in PARAMETERS]
    spelled = [n for row in parameter_names(r) for n in row]
    assert len(spelled) == len(flat)
    for (_, kernel_name), record_name in zip(flat, spelled, strict=True):
        assert kernel_name.removeprefix("attachment_").removesuffix("_rad") == record_name.split(".")[-1].removesuffix("_deg")
    got = cable_covariance(r, record)
    assert np.count_nonzero(np.diag(got)) == 2 + 1 + 1 + 2  # c1: x, alpha, tool.P1.z; c2: scale; c3, from B1 too: x, alpha
    x1, alpha1, x3 = spelled.index("B1.x_mm"), spelled.index("B1.guide_alpha_deg"), 2 * len(PARAMETERS)
    assert got[x1, x1] == 4.0
    assert got[x1, x3] == 4.0
    assert got[x1, alpha1] == pytest.approx(0.3 * 2 * math.radians(0.5))
    assert not cable_covariance(r, None).any()


def test_a_file_of_lengths_has_each_channel_in_its_unit(tmp_path: Path) -> None:
    cell = cell_rig(1).model_dump(by_alias=True, exclude_none=True)
    distance = {"channel": "d1", "to": "P1", "position_mm": [900.0, 0.0, 0.0], "count_length_mm": 0.01, "zero_mm": 0.0}
    swivel = {"point": "B1", "channel": "sw1", "counts_per_revolution": 131072, "zero_deg": 12.5}
    rig = rig_from_dict(cell | {"distance": [distance], "swivel": [swivel]})
    simulated = lm.simulate(seed=1, rig=rig, rate_hz=50.0, waypoint=[{"position_mm": [50.0, 0.0, 0.0]}]).run
    assert simulated is not None
    lengths = lm.lengths_from_counts(simulated.run)
    lm.write_lengths(tmp_path / "lengths.csv", lengths)
    read = lm.read_lengths(tmp_path / "lengths.csv")
    assert {"d1_mm", "sw1_rad"} < set(read.columns())
    assert read.cables == lengths.cables
    np.testing.assert_array_equal(read.change_mm, lengths.change_mm)
