from frame_fuzz import fuzz


def test_mutated_frames_are_counted_or_refused() -> None:
    done = fuzz(30_000, seed=1)
    assert done["frames"] >= 30_000
    assert done["faults"] > 1000
