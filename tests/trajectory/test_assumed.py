"""What nobody stated has a typical size, in the uncertainty of every result, unless all that is not stated is exact by statement."""

import json
import math
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import real_rig
from scipy.spatial.transform import Rotation
from test_unsolved import START, after_play, delta, nominal, truth

from lmeasure.accuracy import exact_radius_95, radii_95, scan_zone, stated_radii_95, tilts
from lmeasure.calibration import CalibrationSettings, Campaign, calibrate
from lmeasure.core import FloatArray, se3
from lmeasure.recording import Counts, Poses, Run, read_run, read_run_head, write_run
from lmeasure.rig import TYPICAL_SIZES, CalibrationRecord, Dimension, Rig, rig_from_dict
from lmeasure.trajectory import Trajectory, covariances, read_trajectory, reconstruct, reconstruct_stream, write_trajectory

AUTHORITIES = Path(__file__).parents[1] / "authorities"


def rig_of(seed: int, **keys: Any) -> Rig:
    """A rig that states nothing but these keys, where they belong."""
    data = nominal(truth(seed)) | {"unstated": "typical"}
    for point in data["observation_point"]:
        for key, value in keys.items():
            of_drum = key in ("u_count_length_mm", "u_groove_pitch_mm", "u_run_out_mm", "u_backlash_counts", "u_friction_counts")
            of_point = key in ("u_pulley_eccentricity_mm", "u_swivel_offset_mm")
            (point["drum"] if of_drum else point if of_point else data)[key] = value
    return rig_from_dict(data)


def run_of(rig: Rig, counts: FloatArray, **keys: Any) -> Run:
    return Run(rig, START, (Counts(np.arange(len(counts)) / 100.0, rig.channels, counts),), **keys)


def counts_of(seed: int = 2, count: int = 60) -> FloatArray:
    return np.rint(truth(seed).true_counts(real_rig.path(np.random.default_rng(seed), count), START))


TYPICAL = {key: size.value * (real_rig.COUNT_MM if size.relative else 1.0) for key, size in list(TYPICAL_SIZES.items())[:8]}
START_TYPICAL = (0.3, math.radians(0.05))


def u95(found: Trajectory) -> float:
    whole = (found.random + found.systematic)[:, 3:, 3:]
    return max(exact_radius_95(np.linalg.eigvalsh(c)) for c in whole[-10:])


def test_sizes_are_those_of_the_contract() -> None:
    assert (
        pytest.approx(
            {
                "u_count_length_mm": 5e-4 * real_rig.COUNT_MM,
                "u_groove_pitch_mm": 0.01,
                "u_run_out_mm": 0.02,
                "u_pulley_eccentricity_mm": 0.05,
                "u_swivel_offset_mm": 0.05,
                "u_attachment_mm": 0.3,
                "u_backlash_counts": 1.0,
                "u_friction_counts": 4.0,
            }
        )
        == TYPICAL
    )
    run = run_of(rig_of(2), counts_of())
    assert run.start_errors.u == pytest.approx(START_TYPICAL)
    assert replace(run, u_start=(0.1, None)).start_errors.u == pytest.approx((0.1, START_TYPICAL[1]))
    assert replace(run, u_start=(0.0, 0.0)).start_errors.u == replace(run, unstated="exact").start_errors.u == (0.0, 0.0)


def test_a_missing_key_is_what_stating_its_typical_size_is() -> None:
    counts = counts_of()
    assumed = reconstruct(run_of(rig_of(2), counts, temperature_c=20.0))
    stated = reconstruct(run_of(rig_of(2, **TYPICAL), counts, temperature_c=20.0, u_start=START_TYPICAL))
    np.testing.assert_allclose(assumed.systematic, stated.systematic, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(assumed.random, stated.random, rtol=1e-12)
    assert stated.u95_assumed_mm is not None
    np.testing.assert_array_equal(stated.u95_assumed_mm, 0.0)
    assert assumed.u95_assumed_mm is not None
    # counts that are zeroed exactly leave nothing else that a run shares
    alone = [exact_radius_95(np.linalg.eigvalsh(c)) for c in assumed.systematic[::20, 3:, 3:]]
    np.testing.assert_allclose(assumed.u95_assumed_mm[::20], alone, rtol=1e-3)


def test_zero_and_exact_are_exact() -> None:
    counts = counts_of()
    zeros = dict.fromkeys(TYPICAL, 0.0)
    for run in (
        run_of(rig_of(2, **zeros), counts, temperature_c=20.0, u_start=(0.0, 0.0)),
        run_of(rig_of(2).model_copy(update={"unstated": "exact"}), counts, unstated="exact"),
    ):
        found = reconstruct(run)
        assert not found.systematic.any()
        assert not found.assumed.statements
    assert 'unstated = "exact"' in found.summary()


@pytest.mark.parametrize("key", ["u_count_length_mm", "u_attachment_mm", "u_pulley_eccentricity_mm", "u_position_mm"])
def test_a_statement_leaves_what_it_promises(key: str) -> None:
    counts = counts_of()
    found = reconstruct(run_of(rig_of(2), counts, temperature_c=20.0)).assumed
    size = TYPICAL_SIZES[key].stated * (real_rig.COUNT_MM if TYPICAL_SIZES[key].relative else 1.0)
    stated = key in TYPICAL
    rig, u_start = rig_of(2, **({key: size} if stated else {})), (None if stated else size, None)
    then = reconstruct(run_of(rig, counts, temperature_c=20.0, u_start=u_start)).assumed
    promised = {one.key: one.u95_mm for one in found.every}[key]
    assert then.u95_mm == pytest.approx(promised, rel=1e-9)
    assert then.u95_mm < found.u95_mm


def test_statements_are_sorted_and_few_and_survive_pieces_and_files(tmp_path: Path) -> None:
    run = run_of(rig_of(2), counts_of())
    found = reconstruct(run)
    left = [one.u95_mm for one in found.assumed.statements]
    assert left == sorted(left)
    assert 1 <= len(left) <= 5
    assert "state the start position to 0.02 mm (u_position_mm): U95 " in found.summary()
    assert not [line for line in found.assumed.lines if any(word in line.text("ru") for word in ("state the", "typical"))]
    write_run(tmp_path / "run", run)
    assert reconstruct_stream(read_run_head(tmp_path / "run"), tmp_path / "out.parquet").text() == found.summary()
    kept = read_trajectory(tmp_path / "out.parquet").u95_assumed_mm
    assert kept is not None
    assert found.u95_assumed_mm is not None
    np.testing.assert_allclose(kept, found.u95_assumed_mm, rtol=1e-12)
    write_trajectory(tmp_path / "out.csv", found)
    assert "u95_assumed_mm" in (tmp_path / "out.csv").read_text().splitlines()[0]


def test_worlds_drawn_from_typical_sizes_are_inside_u95() -> None:
    """By a forward model that shares no code: drums, pulleys, attachment points, play, start and temperature drawn, nothing stated."""
    rng, inside, trials = np.random.default_rng(11), [], 80
    for i in range(trials):
        plain = truth(20 + i % 6)
        true = real_rig.without(
            plain,
            stretch=rng.normal(0, 5e-4, 6),
            pitch_mm=rng.normal(0, 0.01, 6),
            run_out_mm=rng.normal(0, 0.02, (6, 2)),
            eccentric_mm=rng.normal(0, 0.05, (6, 2)),
            tool=rng.normal(0, 0.3, (3, 3)),
            expansion_per_k=11.5e-6,
        )
        poses = real_rig.path(rng, 40)
        poses[0] = se3.displaced(START[None], np.r_[rng.normal(0, START_TYPICAL[1], 3), rng.normal(0, 0.3, 3)][None])[0]
        exact = true.true_counts(poses, poses[0])
        half = np.abs(rng.normal(0, math.hypot(1.0, 4.0), 6))
        recorded = np.rint(after_play(exact, half, rng.choice([-1.0, 1.0], 6)))
        data = nominal(plain) | {"unstated": "typical"}
        found = reconstruct(run_of(rig_from_dict(data), recorded, temperature_c=20.0))
        last = np.flatnonzero(found.status == 0)[-1]
        error = found.poses[last, :3] - poses[last, :3]
        covariance = np.asarray(found.random + found.systematic, dtype=np.float64)[last, 3:, 3:]
        inside.append(np.linalg.norm(error) < float(radii_95(covariance[None])[0]))
    assert 0.9 <= np.mean(inside) <= 0.995, np.mean(inside)


def test_a_start_that_is_off_by_a_typical_size_is_inside_u95() -> None:
    poses = real_rig.path(np.random.default_rng(3), 40)
    poses[0] = se3.displaced(START[None], np.array([[0, 0, 0, 0.3, 0, 0]]))[0]
    counts = np.rint(truth(3).true_counts(poses, poses[0]))
    for unstated, covered in (("typical", True), ("exact", False)):
        found = reconstruct(run_of(rig_of(3).model_copy(update={"unstated": "exact"}), counts, unstated=unstated, temperature_c=20.0))
        assert (np.linalg.norm(delta(found.poses, poses)[-1, 3:]) < u95(found)) == covered


def test_what_a_run_shares_widens_poses_and_not_their_differences() -> None:
    """Two visits of one pose on the same way: start, temperature and dimensions cancel; the pose itself has them in full."""
    way = np.vstack([real_rig.path(np.random.default_rng(5), 30)] * 3)
    rig = rig_of(5, u_backlash_counts=0.0, u_friction_counts=0.0)
    run = run_of(rig, np.rint(truth(5).true_counts(way, START)))
    found = reconstruct(run)
    factors = covariances(found, run, np.array([45, 75])).factors
    assert np.abs(factors[1] - factors[0])[3:].max() < 1e-3
    assert u95(found) > 0.5
    whole = covariances(found, run, np.array([45, 75]))
    assert {"start pose", "temperature", "dimensions as stated"} <= set(whole.sources)


def test_the_temperature_that_nobody_stated_is_five_kelvin_of_steel() -> None:
    """By finite differences of the poses: the same counts when every cable grew since it was zeroed."""
    counts = counts_of()
    rig = rig_of(2).model_copy(update={"unstated": "exact"})
    found = reconstruct(run_of(rig, counts, u_start=(0.0, 0.0)))
    warmer = [{"drum": p.drum.model_copy(update={"cable_expansion_per_k": 11.5e-6})} for p in rig.observation_point]
    points = tuple(p.model_copy(update=change) for p, change in zip(rig.observation_point, warmer, strict=True))
    warm = Counts(np.arange(len(counts)) / 100.0, rig.channels, counts, temperature_c=np.r_[20.0, np.full(len(counts) - 1, 25.0)])
    grown = Run(rig.model_copy(update={"observation_point": points}), START, (warm,), temperature_c=20.0, u_start=(0.0, 0.0))
    moved = np.linalg.norm(reconstruct(grown).poses[1:, :3] - found.poses[1:, :3], axis=1)
    u = np.sqrt(np.einsum("nii->n", found.systematic[1:, 3:, 3:]))
    np.testing.assert_allclose(u, moved, rtol=0.1)


@pytest.mark.parametrize(
    ("calibrated_c", "expands", "begun_c", "now_c", "keys"),
    [
        (None, False, 20.0, 20.0, ["calibration.temperature_c"]),
        (None, False, 20.0, 26.0, ["calibration.temperature_c", "cable_expansion_per_k"]),
        (None, True, 20.0, 26.0, ["calibration.temperature_c"]),
        (16.0, False, 20.0, 26.0, ["cable_expansion_per_k"]),
        (16.0, True, 20.0, 26.0, []),
    ],
)
def test_steel_of_another_temperature_than_the_calibrations_errs_as_its_matter_says(
    calibrated_c: float | None, expands: bool, begun_c: float, now_c: float, keys: list[str]
) -> None:
    """By the matter of the cable: a count pays out the same matter at any temperature, and free matter grows."""
    true, a = truth(2), 11.5e-6
    poses = real_rig.path(np.random.default_rng(4), 30)
    lengths = true.spans(np.vstack([START[None], poses]))[0]

    def counts(calibrated: float, begun: float, now: float) -> FloatArray:
        k = np.zeros_like(lengths)
        for _ in range(30):
            free = lengths + np.hypot(true.tangent, true.axial + k * true.pitch / real_rig.COUNTS_PER_REVOLUTION)
            matter = free / (1.0 + a * (np.r_[begun, np.full(len(poses), now)][:, None] - calibrated))
            k = (matter - matter[0]) / real_rig.COUNT_MM
        return k

    data = rig_of(2, **dict.fromkeys(TYPICAL, 0.0)).to_dict()
    for point in data["observation_point"]:
        point["drum"] |= {"cable_expansion_per_k": a, "drum_expansion_per_k": a} if expands else {}
    record = CalibrationRecord(
        rig="real", parameters=(), covariance=(), residuals=(), equations=0, unknowns=0, rank=0, temperature_c=calibrated_c
    )
    data |= {"reference_temperature_c": 20.0 if calibrated_c is None else calibrated_c}

    def found(k: FloatArray) -> Trajectory:
        warm = np.r_[begun_c, np.full(len(poses), now_c)]
        rig = rig_from_dict(data)
        counted = Counts(np.arange(len(k)) / 100.0, rig.channels, k, temperature_c=warm)
        return reconstruct(Run(rig, START, (counted,), record, u_start=(0.0, 0.0)))

    plain = found(counts(20.0, 20.0, 20.0))
    moved = []
    if "calibration.temperature_c" in keys:
        moved.append(found(counts(15.0, 20.0, 20.0)).poses - found(counts(20.0, 20.0, 20.0)).poses)
    if "cable_expansion_per_k" in keys:
        reference = begun_c if calibrated_c is None else calibrated_c
        moved.append(found(counts(reference, begun_c, now_c)).poses - plain.poses)
    expected = np.sqrt(sum(((m[1:, :3] ** 2).sum(axis=1) for m in moved), start=np.zeros(len(poses))))
    u = np.sqrt(np.einsum("nii->n", plain.systematic[1:, 3:, 3:]))
    np.testing.assert_allclose(u, expected, rtol=0.12, atol=1e-4)
    assert {one.key for one in plain.assumed.every if one.u95_mm < plain.assumed.u95_mm} == set(keys)


def test_angles_of_drums_and_pulleys_follow_from_the_calibration() -> None:
    """A run that begins elsewhere than the calibration: only the lengths of its cables give the angles."""
    rng = np.random.default_rng(8)
    plain = truth(3)
    true = real_rig.without(plain, run_out_mm=rng.normal(0, 0.06, (6, 2)), eccentric_mm=rng.normal(0, 0.15, (6, 2)))
    poses = real_rig.path(np.random.default_rng(9), 400)[120:]
    counts = true.true_counts(poses, START)
    data = nominal(plain) | {"unstated": "typical"}
    begun = true.spans(START[None])[0][0]
    for cable, length in zip(data["cable"], begun.tolist(), strict=True):
        cable["zero_length_mm"] = length
    dimensions = []
    for j, point in enumerate(data["observation_point"]):
        point["phase_length_mm"] = float(begun[j])
        point["pulley_eccentricity_mm"] = true.flaws.eccentric_mm[j].tolist()
        point["drum"]["run_out_mm"] = true.flaws.run_out_mm[j].tolist()
        dimensions += [(f"{point['name']}.{part}_{c}_mm", 0.006) for part in ("run_out", "pulley_eccentricity") for c in ("cos", "sin")]
    own = [
        Dimension(name=name, value=0.0, u=u, prior_u=0.1, covariance=tuple(np.where(np.arange(24) == i, u**2, 0.0).tolist()))
        for i, (name, u) in enumerate(dimensions)
    ]
    nothing: Any = {"parameters": (), "covariance": (), "residuals": (), "equations": 0, "unknowns": 0, "rank": 0}
    record = CalibrationRecord(rig="real", **nothing, dimensions=tuple(own))

    def found(rig: Rig, calibration: CalibrationRecord | None) -> tuple[float, str, float]:
        recorded = Counts(np.arange(len(counts)) / 100.0, rig.channels, np.rint(counts - counts[0]))
        run = Run(rig, poses[0], (recorded,), calibration, u_start=(0.0, 0.0), temperature_c=20.0)
        trajectory = reconstruct(run)
        off = np.linalg.norm(trajectory.poses[:, :3] - poses[:, :3], axis=1)
        u95 = stated_radii_95((trajectory.random + trajectory.systematic)[:, 3:, 3:])
        return float(off.max()), "; ".join(map(str, trajectory.notes)), float((off / u95)[1:].max())

    rig = rig_from_dict(data)
    points = tuple(p.model_copy(update={"phase_length_mm": None}) for p in rig.observation_point)
    known, said, _ = found(rig, record)
    lost, said_at_zero, part = found(rig.model_copy(update={"observation_point": points}), record)
    assert known < 0.03 < 0.3 < lost
    assert "follow from the calibration and the cable lengths there (B1, B2, B3, B4, B5, B6)" in said
    assert "the uncertainty includes any other angle" in said_at_zero
    assert part < 1.0
    assert "run-out and eccentricity are in the uncertainty at any angle" in found(rig_of(3), None)[1]


def test_pay_out_points_are_where_the_lengths_at_the_start_put_them() -> None:
    """Exact drums, zeroed elsewhere than where their axial offsets hold; the same with a start that swivels determine."""
    plain = truth(3)
    poses = real_rig.path(np.random.default_rng(9), 400)[120:]
    counts = plain.true_counts(poses, START)
    data = nominal(plain)
    for cable, length in zip(data["cable"], plain.spans(START[None])[0][0].tolist(), strict=True):
        cable["zero_length_mm"] = length
    rig = rig_from_dict(data)
    points = [np.einsum("nab,b->na", Rotation.from_quat(poses[:, 3:]).as_matrix(), plain.tool[t]) + poses[:, :3] for t in plain.tied]
    angles = []
    for j, point in enumerate(points):
        a, b, u = plain.alpha[j], plain.beta[j], plain.arriving[j]
        e0 = np.array([math.sin(a) * math.sin(b), math.sin(a) * math.cos(b), math.cos(a)])
        angles.append(np.arctan2((point - plain.base[j]) @ np.cross(u, e0), (point - plain.base[j]) @ e0))
    codes = np.rint(np.array(angles).T / (2.0 * np.pi) * 2**17) % 2**17
    swivel = [
        {"point": f"B{j + 1}", "channel": f"sw{j + 1}", "counts_per_revolution": 2**17, "absolute": True, "zero_deg": 0.0} for j in range(6)
    ]

    def off(rig: Rig, start: FloatArray | None, recorded: FloatArray, channels: tuple[str, ...]) -> float:
        run = Run(rig, start, (Counts(np.arange(len(recorded)) / 100.0, channels, recorded),), unstated="exact")
        found = reconstruct(run)
        return float(np.linalg.norm(found.poses[:, :3] - poses[:, :3], axis=1).max())

    stays = off(rig_from_dict(nominal(plain)), poses[0], np.rint(counts - counts[0]), rig.channels)
    assert off(rig, poses[0], np.rint(counts - counts[0]), rig.channels) < 0.02 < 0.1 < stays
    nothing: Any = {"parameters": (), "covariance": (), "residuals": (), "equations": 0, "unknowns": 0, "rank": 0}
    record = CalibrationRecord(rig="real", **nothing, zero_length_mm={c["name"]: c["zero_length_mm"] for c in data["cable"]})
    for own, said in ((rig_from_dict(nominal(plain)), True), (rig, False)):
        run = run_of(own, np.rint(counts - counts[0]), calibration=record, unstated="exact")
        notes = reconstruct(replace(run, start=poses[0])).notes
        assert any("the counters were zeroed with up to" in str(note) for note in notes) is said
        assert any("NOT include" in str(note) for note in notes) is said
    # nobody stated whether the drums were turned back: U95 holds rigs of either law, and says what brings it down
    typical = rig_of(3, **dict.fromkeys(TYPICAL, 0.0))
    for travelled in (plain.true_counts(poses, poses[0]), counts - counts[0]):
        run = replace(run_of(typical, np.rint(travelled), calibration=record, u_start=(0.0, 0.0), temperature_c=20.0), start=poses[0])
        found, alone = reconstruct(run), reconstruct(replace(run, calibration=None))
        error = found.poses[1:, :3] - poses[1:, :3]
        square = np.einsum("ni,nij,nj->n", error, np.linalg.inv((found.random + found.systematic)[1:, 3:, 3:]), error)
        assert np.mean(square <= 7.8147) > 0.95
        assert 0.05 < found.assumed.part_mm < 0.5
        assert "to 10 mm (zero_length_mm)" in found.summary()
        np.testing.assert_array_equal(found.poses, alone.poses)

    def zone(start: FloatArray, record: CalibrationRecord | None) -> FloatArray:
        x, y, z = poses[200, :3, None]
        data = scan_zone(typical, record, x=x, y=y, z=z, rotations=tilts(0.0, 1), start=start)
        return np.asarray(data["u95_position_mm"].values).ravel()

    np.testing.assert_array_equal(zone(START, record), zone(START, None))
    assert zone(poses[0], record)[0] > 1.5 * zone(poses[0], None)[0]
    both = rig_from_dict(data | {"swivel": swivel})
    recorded = np.hstack([np.rint(counts - counts[40]), codes])
    assert off(both, None, recorded, both.all_channels) < 0.03
    assert pickle.loads(pickle.dumps(rig.zeroed_at(poses[0]))).paid_out() == pytest.approx(rig.zeroed_at(poses[0]).paid_out())


def test_pay_out_points_of_a_calibration_follow_the_points_that_it_finds() -> None:
    """Exact poses and drums with large pitches; the nominal lengths at the zero pose are 15 mm off. The run begins elsewhere."""
    rng, plain = np.random.default_rng(12), replace(truth(3), pitch=np.full(6, 6.0))
    data = plain.drawing(rng, 15.0, 0.5)
    for cable, length in zip(data["cable"], plain.spans(START[None])[0][0].tolist(), strict=True):
        cable["zero_length_mm"] = length
    poses = np.vstack([START[None], real_rig.scattered(rng, 20)])
    names, exact = tuple(map(str, range(len(poses)))), np.zeros(len(poses))
    rig = rig_from_dict(data)
    campaign = Campaign(rig, Poses(names, poses, exact, exact), rig.cable, plain.true_counts(poses, START), np.zeros(6, np.int64))
    found = calibrate(campaign, CalibrationSettings())
    way = real_rig.path(rng, 200)[80:]
    counts = plain.true_counts(way, START)
    run = Run(found.rig, way[0], (Counts(np.arange(len(way)) / 100.0, found.rig.channels, counts - counts[0]),), found.record)
    off = np.linalg.norm(reconstruct(run).poses[:, :3] - way[:, :3], axis=1)
    assert off.max() < 0.002


def test_exact_rigs_keep_their_figures_to_all_digits() -> None:
    kept = json.loads((AUTHORITIES / "exact-figures" / "figures.json").read_text())
    for name in ("cell-run", "swivel-run", "three-drums-two-passes"):
        rows, found = kept[name]["rows"], reconstruct(read_run(AUTHORITIES / "truth" / name))
        np.testing.assert_allclose(found.poses[rows], kept[name]["poses"], rtol=1e-12, atol=1e-12)
        # the swivels' sub-count offsets follow a search that ends anywhere within its tolerance: 1e-12 mm in a point change u by 2e-5
        same = 1e-4 if name == "swivel-run" else 1e-12
        np.testing.assert_allclose(found.u[rows], kept[name]["u"], rtol=same)
        systematic = np.einsum("nii->ni", found.systematic)[rows]
        np.testing.assert_allclose(systematic, kept[name]["systematic"], rtol=same, atol=(same - 1e-12) * systematic.max())
    run, x = read_run(AUTHORITIES / "truth" / "cell-run"), np.array([-100.0, 150.0])
    zone = scan_zone(run.rig, None, x=x, y=x, z=x, rotations=tilts(0.2, 2), start=run.start)
    np.testing.assert_allclose(zone["u95_position_mm"].values.ravel(), kept["zone"], rtol=1e-12)


def test_a_zone_says_what_is_assumed() -> None:
    x = np.linspace(-100.0, 100.0, 3)
    zones = [
        scan_zone(rig, None, x=x, y=x, z=x, rotations=tilts(0.0, 1), start=START)
        for rig in (rig_of(2), rig_of(2, **TYPICAL), rig_of(2).model_copy(update={"unstated": "exact"}))
    ]
    assumed, stated, exact = (zone["u95_position_mm"].values for zone in zones)
    np.testing.assert_allclose(assumed, stated, rtol=1e-9)
    assert (assumed > 5.0 * exact).all()
    assert [zone.attrs["u95_assumed_mm"] > 0.0 for zone in zones] == [True, False, False]
    assert "state the " in zones[0].attrs["assumed"]
