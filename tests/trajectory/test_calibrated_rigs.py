"""Runs of sound instruments with redundant channels, by rigs that were calibrated: nothing slips, and no channel is left out."""

import numpy as np

import lmeasure as lm


def test_nothing_slips_in_a_sound_run() -> None:
    """Six cables and two distances, whose positions the calibration finds as it finds the cables'."""
    drawn = lm.simulate(seed=1, waypoint=[{"position_mm": [1.0, 0.0, 0.0]}]).run
    assert drawn is not None
    cell = drawn.run.rig.model_dump(by_alias=True, exclude_none=True)
    places = {"d1": ("P3", [1200.0, 400.0, -300.0]), "d2": ("P1", [-1400.0, -300.0, 400.0])}
    distances = [
        {"channel": name, "to": to, "position_mm": at, "u_position_mm": 0.5, "count_length_mm": 0.01, "zero_mm": 0.0, "u_zero_mm": 0.5}
        for name, (to, at) in places.items()
    ]
    turned = [0.0871557, 0.0, 0.0, 0.9961947], [0.0, 0.0871557, 0.0, 0.9961947], [0.0, 0.0, 0.0871557, 0.9961947]
    ways = [[150.0, 100.0, 50.0], [-100.0, 150.0, -50.0], [-150.0, -100.0, 100.0]]
    simulated = lm.simulate(
        seed=1,
        rig=lm.rig_from_dict(cell | {"distance": distances}),
        rate_hz=50.0,
        motion={"speed_mm_s": 250.0, "rotation_speed_deg_s": 30.0, "dwell_s": 0.5},
        waypoint=[{"position_mm": at, "quaternion_xyzw": q} for at, q in zip(ways, turned, strict=True)],
        reference_poses={"count": 16, "u_position_mm": 0.05, "u_rotation_deg": 0.01},
    )
    assert simulated.run is not None
    trajectory = lm.reconstruct(simulated, rig=lm.calibrate(simulated))
    assert not trajectory.status.any()
    assert not (trajectory.cable != "").any()
    codes = {note.code for note in trajectory.notes}
    assert not codes & {"channel.left_out", "channels.contradict", "cable.left_out"}, codes
    error = trajectory.poses[:, :3] - simulated.run.poses[:, :3]
    u = np.sqrt(np.einsum("nii->ni", (trajectory.random + trajectory.systematic)[:, 3:, 3:]))
    assert np.abs(error / u).max() < 4.0
