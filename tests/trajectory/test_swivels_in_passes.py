"""Three drums that measure six cables in two passes, and an encoder on each swivel that both passes read."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from cells import START, FloatArray, cell
from scipy.stats import chi2

from lmeasure.core import Status, se3
from lmeasure.procedures.intermediate_check.moved_parts import StopContradictions
from lmeasure.recording import Run
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import simulate_run
from lmeasure.trajectory import RESTORED_ORIGIN, RunModel, align, covariances, prepare, reconstruct, reconstruction_of, zero_columns

TIME_S = np.arange(0.0, 1.2, 0.006)
ZEROS_DEG = np.array([12.0, -140.0, 71.0])
U_ZERO_DEG = 0.01


def of_two_passes(zeros_deg: FloatArray) -> Rig:
    """c1 to c3 in pass 1, and in pass 2 other cables from the same points."""
    data = cell().to_dict()
    points = [p["name"] for p in data["observation_point"]][:3]
    for i, c in enumerate(data["cable"]):
        c |= {"channel": f"ch{i % 3 + 1}", "pass": i // 3 + 1, "from": points[i % 3], "to": f"P{(i + i // 3) % 3 + 1}"}
    swivels = [
        {"point": p, "channel": f"sw{i + 1}", "counts_per_revolution": 2**17, "zero_deg": float(z), "u_zero_deg": U_ZERO_DEG}
        for i, (p, z) in enumerate(zip(points, zeros_deg, strict=True))
    ]
    return rig_from_dict(data | {"observation_point": data["observation_point"][:3], "swivel": swivels})


def run_of(seed: int, *, start: bool = True) -> tuple[Run, FloatArray]:
    rng = np.random.default_rng(seed)
    way = rng.uniform(1.5, 3.0, (2, 6))
    begin = se3.displaced(START, np.repeat([0.05, 40.0], 3) * rng.uniform(-1.0, 1.0, 6))
    swing = np.sin(way[0] * TIME_S[:, None]) + 0.3 * np.sin(3.0 * way[1] * TIME_S[:, None])
    poses = se3.displaced(begin, np.repeat([0.15, 100.0], 3) * rng.uniform(0.4, 1.0, 6) * swing)
    run = simulate_run(of_two_passes(ZEROS_DEG), TIME_S, poses, noise_mm=0.0, rng=rng).run
    nominal = of_two_passes(ZEROS_DEG + U_ZERO_DEG * rng.standard_normal(3))
    return replace(run, rig=nominal, start=run.start if start else None), poses


@pytest.mark.parametrize(("start", "seeds"), [(True, range(2)), (False, (0, 13))])
def test_poses_err_as_stated(start: bool, seeds: Sequence[int]) -> None:
    """One zero of an encoder acts in both passes; a drum is zeroed in each. Of those without a start the first samples fit another
    assembly too, in which the drums cannot go on."""
    squares: list[float] = []
    for seed in seeds:
        run, poses = run_of(seed, start=start)
        found = reconstruct(run)
        both = covariances(found, run)
        covariance = both.random + both.factors @ np.swapaxes(both.factors, 1, 2)
        assert (found.status == Status.OK).all()
        error = se3.displacement(found.poses, poses)
        squares.append(float(error[130] @ np.linalg.solve(covariance[130], error[130])))
    assert 0.001 < chi2.cdf(sum(squares), 6 * len(seeds)) < 0.999


def test_a_drum_that_slips_in_its_second_pass_is_restored() -> None:
    run, poses = run_of(3)
    second = run.passes[1]
    recorded = second.recorded.copy()
    recorded[90:, second.channels.index("ch2")] += 400
    found = reconstruct(replace(run, passes=(run.passes[0], replace(second, recorded=recorded))))
    assert any("Restored from the other channels" in str(note) for note in found.notes)
    assert RESTORED_ORIGIN in {cause.code for cause in found.cause[95:]}
    assert (found.status == Status.OK).all()
    np.testing.assert_allclose(found.poses[:, :3], poses[:, :3], atol=0.05)


def test_an_encoder_is_named_with_the_pass_in_which_it_errs() -> None:
    run, poses = run_of(4)
    second = run.passes[1]
    recorded = second.recorded.copy()
    sw3 = second.channels.index("sw3")
    recorded[90:, sw3] = (recorded[90:, sw3] + 800) % 2**17
    found = reconstruct(replace(run, passes=(run.passes[0], replace(second, recorded=recorded))))
    assert any("swivel sw3@2 differs from the other" in str(note) for note in found.notes)
    assert set(found.cable[95:]) == {"sw3@2"}
    np.testing.assert_allclose(found.poses[:, :3], poses[:, :3], atol=0.05)


def test_a_rig_of_one_pass_has_plain_names() -> None:
    data = of_two_passes(ZEROS_DEG).to_dict()
    assert [o.name for o in of_two_passes(ZEROS_DEG).observed[6:]] == ["sw1@1", "sw1@2", "sw2@1", "sw2@2", "sw3@1", "sw3@2"]
    alone = [c | {"channel": c["name"]} for c in data["cable"] if c["pass"] == 1]
    assert [o.name for o in rig_from_dict(data | {"cable": alone}).observed[3:]] == ["sw1", "sw2", "sw3"]


def test_of_two_assemblies_the_one_is_begun_in_which_the_drums_go_on() -> None:
    """The other fits the first samples as well, 47 mm away, and is found nearer to where it begins."""
    run, poses = run_of(13, start=False)
    start = prepare(align(run)).model.zero_pose
    assert np.linalg.norm(start[:3] - poses[0, :3]) < 1.0


def test_an_encoder_has_one_zero_and_one_fault_in_all_passes_and_so_has_a_drum() -> None:
    run, poses = run_of(5)
    rig = run.rig
    columns, names = zero_columns(rig, None)
    assert names == ["sw1", "sw2", "sw3"]
    assert [np.flatnonzero(column).tolist() for column in columns.T] == [[6, 7], [8, 9], [10, 11]]
    reconstruction = reconstruction_of(RunModel(rig, poses[0]))
    redundancy = reconstruction.redundancy
    assert redundancy is not None
    epochs, some = redundancy.epochs(align(run).lengths, None), np.arange(0, 200, 20)
    together = StopContradictions(reconstruction, redundancy, epochs.at(some), poses[some])
    acts = {
        name: np.flatnonzero(errors.any(axis=(0, 2))).tolist()
        for kind, name, *_, errors in together.errors()
        if kind in ("encoder", "drum")
    }
    assert acts == {"B1": [0, 3], "B2": [1, 4], "B3": [2, 5], "sw1": [6, 7], "sw2": [8, 9], "sw3": [10, 11]}
