"""Reliability figures against what they say: a fault of the stated size is put into a reading, and what comes of it is looked at."""

from dataclasses import replace

import numpy as np
import pytest
from test_truth import AUTHORITY

from lmeasure.recording import read_run
from lmeasure.text import plain
from lmeasure.trajectory import Epochs, align, collect_epochs, prepare
from lmeasure.trajectory.faults.redundancy import SHIFT, places_of_reliability, reliability, reliability_notes


@pytest.mark.parametrize(("name", "samples", "channels"), [("eight-run", 300, 8), ("swivel-run", 200, 12)])
def test_a_fault_of_the_stated_size_does_what_is_stated(name: str, samples: int, channels: int) -> None:
    whole = read_run(AUTHORITY / name)
    counts = whole.passes[0]
    run = replace(whole, passes=(replace(counts, time_s=counts.time_s[:samples], recorded=counts.recorded[:samples]),))
    aligned = align(run)
    reconstruction = prepare(aligned)
    assert reconstruction.redundancy is not None
    lengths = reconstruction.corrected(aligned.lengths)
    epochs = reconstruction.redundancy.epochs(lengths, None).at(np.arange(0, samples, 40))
    poses = reconstruction.poses_of(epochs.change_mm)
    found = reliability(reconstruction.redundancy, epochs, poses)
    np.testing.assert_allclose(found.redundancy.sum(axis=1), channels - 6, atol=1e-9)
    assert ((found.redundancy > -1e-12) & (found.redundancy < 1.0)).all()
    sound = reconstruction.redundancy.parities(epochs, poses).errors[0]
    for j in range(channels):
        # a part of it, so that nothing bends; the figures are linear
        part = 1e-2 * found.smallest[:, j]
        moved = epochs.change_mm.copy()
        moved[:, j] += part
        spoiled: Epochs = replace(epochs, change_mm=moved, gone_on_mm=moved)
        error, u = reconstruction.redundancy.parities(spoiled, poses).errors
        np.testing.assert_allclose((error - sound)[:, j] / u[:, j], 1e-2 * SHIFT, rtol=1e-6)
        np.testing.assert_allclose((error - sound) / u, 1e-2 * SHIFT * found.correlation[:, j], rtol=1e-6, atol=1e-9)
        away = reconstruction.poses_of(moved)[:, :3] - poses[:, :3]
        np.testing.assert_allclose(np.linalg.norm(away, axis=1), 1e-2 * found.effect_mm[:, j], rtol=1e-3)
    some = places_of_reliability(collect_epochs(reconstruction, [aligned.lengths])[0])
    shown = reliability(
        reconstruction.redundancy, some, reconstruction.poses_of(some.change_mm - reconstruction.budget.estimated_offsets(some.time_s))
    )
    size = shown.apart[:, 0]
    least = f"{size.min():.2g} mm, none at some samples" if np.isinf(size).any() else f"{size.min():.2g} to {size.max():.2g} mm"
    largest, smallest = reliability_notes(run.rig, shown)
    assert f": c1 {plain(least)}" in plain(str(smallest))
    assert f"). The largest undetected fault moves the tool by up to {shown.effect_mm.max():.3g} mm" in str(largest)
    assert str(reconstruction.reliability[0]).startswith(
        "reliability of single samples (Baarda, significance 0.1 %, power 80 %): redundancy numbers from"
    )


def test_a_channel_that_nothing_controls_is_named() -> None:
    """Of seven cables one without a count: six are left, and none controls another."""
    whole = read_run(AUTHORITY / "eight-run")
    counts = whole.passes[0]
    recorded = counts.recorded[:200].copy()
    recorded[100:, [2, 5]] = np.nan
    run = replace(whole, passes=(replace(counts, time_s=counts.time_s[:200], recorded=recorded),))
    reconstruction = prepare(align(run))
    assert "no other channel checks c1" in str(reconstruction.reliability[0])
    assert "c3 0." in str(reconstruction.reliability[1])
    assert "mm, none at some samples" in str(reconstruction.reliability[1])
