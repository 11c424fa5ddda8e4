"""Sensors that a rig file states: straight distances, and kinds that other packages add, whose laws the kernels call."""

import logging
import math
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.core import CalibrationError, FloatArray, RigError, se3
from lmeasure.kernels import length_gradients, span_lengths, span_rows_of
from lmeasure.rig import Rig, rig_from_dict, table_of
from lmeasure.rig.sensor_table import TABLES
from lmeasure.sensors import AngleSensor, Channels, LengthSensor, SensorKind, counts_from_poses
from lmeasure.simulation import cell_rig

PLACE = [2000.0, 300.0, 500.0]
POSES = np.column_stack(
    [np.random.default_rng(1).uniform(-200.0, 200.0, (4, 3)), Rotation.random(4, rng=np.random.default_rng(2)).as_quat()]
)


class Beam(LengthSensor):
    """A distance as another package would state it."""

    kind: ClassVar[str] = "beam"
    own: ClassVar[tuple[str, ...]] = ("position_mm",)
    position_mm: tuple[float, float, float]
    u_position_mm: float = 0.0
    to: str


def plain(own: FloatArray, place: FloatArray, turn: FloatArray) -> float:
    """Return the distance; this law can be compiled."""
    return float(np.sqrt((place[0] - own[0]) ** 2 + (place[1] - own[1]) ** 2 + (place[2] - own[2]) ** 2))


def interpreted(own: FloatArray, place: FloatArray, turn: FloatArray) -> float:
    """Return the distance; this law runs in Python, and fails behind a wall."""
    if place[0] < -1e3:
        raise ValueError("behind the wall")
    return float(np.linalg.norm(place - own))


@pytest.fixture(params=[plain, interpreted])
def kind(request: pytest.FixtureRequest) -> Iterator[SensorKind]:
    yield SensorKind(table=Beam, reading=request.param).register()
    del TABLES["beam"]


def rig_with(**tables: Any) -> Rig:
    return rig_from_dict(cell_rig(1).to_dict() | {name: [table] for name, table in tables.items()})


def stated(channel: str, **more: Any) -> dict[str, Any]:
    return {"channel": channel, "position_mm": PLACE, "to": "P1", "count_length_mm": 0.01, "zero_mm": 3.0, "u_zero_mm": 0.1} | more


def test_a_distance_is_the_same_as_a_kind_of_this_program_or_another(kind: SensorKind, caplog: pytest.LogCaptureFixture) -> None:
    """Readings by their definition, rates and derivatives by the kernels of both; and what has no reading is a line."""
    rig = rig_with(distance=stated("ld1"), beam=stated("ld2"))
    ours, theirs = Channels.of_rig(rig).rows[-2:, None]
    arms = se3.rotation(POSES).apply(rig.tool["P1"])
    expected = np.linalg.norm(POSES[:, :3] + arms - PLACE, axis=1) - 3.0
    for row in ours, theirs:
        np.testing.assert_allclose(span_lengths(row, POSES)[:, 0], expected, atol=1e-9)
    np.testing.assert_allclose(span_rows_of(theirs, POSES), span_rows_of(ours, POSES), rtol=1e-6, atol=1e-7)
    counts, scales = np.full((4, 1), 70.0), np.ones(1)
    np.testing.assert_allclose(
        length_gradients(theirs, POSES, counts, scales), length_gradients(ours, POSES, counts, scales), rtol=1e-6, atol=1e-8
    )
    k = counts_from_poses(rig, POSES, POSES[0], rig.observed[-2:])
    np.testing.assert_allclose(k, np.column_stack([expected, expected]) / 0.01, rtol=1e-9)
    if kind.reading is interpreted:
        far = POSES[:1] - [5000.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        with caplog.at_level(logging.WARNING, "lmeasure"):
            assert np.isnan(span_lengths(theirs, far)).all()
            assert np.isnan(span_lengths(theirs, far)).all()
        (line,) = caplog.messages
        assert "sensor kind beam of this process: its law fails at some poses: ValueError" in line
        assert "behind the wall" in line


@pytest.mark.parametrize("compiled", [True, False])
def test_rates_of_an_angle_are_smooth_where_it_begins_anew(compiled: bool) -> None:
    """A direction seen across the branch cut of atan2 changes as it does anywhere else."""

    class Sight(AngleSensor):
        kind: ClassVar[str] = "sight"

    def reading(own: FloatArray, place: FloatArray, turn: FloatArray) -> float:
        return math.atan2(place[1], place[0])

    def checked(own: FloatArray, place: FloatArray, turn: FloatArray) -> float:
        if math.isnan(place[0]):
            raise ValueError
        return math.atan2(place[1], place[0])

    SensorKind(table=Sight, reading=reading if compiled else checked).register()
    try:
        rig = rig_with(sight={"channel": "s1", "counts_per_revolution": 3600, "zero_deg": 0.0})
        pose = np.array([[-500.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
        np.testing.assert_allclose(span_rows_of(Channels.of_rig(rig).rows[-1:], pose)[0, 0], [0, 0, 0, 0, -1 / 500, 0], atol=1e-9)
    finally:
        del TABLES["sight"]


def test_channels_are_a_table() -> None:
    rig = rig_with(
        distance=stated("ld1", u_reading_mm=0.02), inclination={"channel": "i1", "axis": [1, 0, 0], "counts_per_revolution": 3600}
    )
    channels = Channels.of_rig(rig)
    assert channels.kinds == ("cable",) * 6 + ("inclination", "distance")
    assert channels.period[[5, 6, 7]].tolist() == [np.inf, 2.0 * np.pi, np.inf]
    assert channels.absolute.tolist() == [False] * 6 + [True, True]
    assert channels.variance[-1] == pytest.approx(0.02**2 + 0.01**2 / 12.0)
    assert channels.parameters[-1][:3] == ("ld1.position_x_mm", "ld1.position_y_mm", "ld1.position_z_mm")
    lines = str(channels).splitlines()
    assert len(lines) == 9
    assert lines[-1].split()[:3] == ["ld1", "distance", "ld1"]


@pytest.mark.parametrize(
    ("table", "text"),
    [
        (stated("ld1", to="P9"), "'P9' is no point of"),
        (stated("ch1"), "'ch1' is the channel of something else"),
        (stated("ld1", absolute=False), "zero_mm: is of absolute sensors"),
        (stated("ld1", count_length_mm=0.0), "must be positive"),
    ],
)
def test_what_a_distance_cannot_be(table: dict[str, Any], text: str) -> None:
    with pytest.raises(RigError, match=text):
        rig_with(distance=table)


def test_what_a_kind_cannot_be() -> None:
    class Large(Beam):
        own: ClassVar[tuple[str, ...]] = ("position_mm", "position_mm", "position_mm")

    with pytest.raises(RigError, match=r"its reading depends on 9 numbers. The limit is 7"):
        SensorKind(table=Large, reading=plain)
    with pytest.raises(TypeError, match="reading must be a function"):
        SensorKind(table=Beam, reading=None)  # type: ignore[arg-type]
    assert table_of("no-such-table") is None


def test_a_self_calibration_leaves_no_frame_to_a_distance() -> None:
    from lmeasure.calibration import CalibrationSettings, calibrate
    from lmeasure.calibration.campaign.campaign import Campaign
    from lmeasure.recording import poses_from_rows

    rig = rig_with(distance=stated("ld1"))
    counts = counts_from_poses(rig, POSES, POSES[0], rig.observed)
    campaign = Campaign(rig, poses_from_rows(POSES), rig.observed, np.rint(counts), np.zeros(7, np.int64))
    with pytest.raises(CalibrationError, match=r"channel ld1 is a \[\[distance\]\], which is stated in the base frame"):
        calibrate(campaign, CalibrationSettings(self_calibration=True))
