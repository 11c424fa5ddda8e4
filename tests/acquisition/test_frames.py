import can
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lmeasure.acquisition.bus.frames import Frames, frames_from_messages, join, messages_from_frames, no_frames
from lmeasure.core import AcquisitionError

FD_LENGTHS = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64]


@st.composite
def messages(draw: st.DrawFn) -> can.Message:
    extended = draw(st.booleans())
    kind = draw(st.sampled_from(["data", "remote", "error", "fd"]))
    length = draw(st.sampled_from(FD_LENGTHS)) if kind == "fd" else draw(st.integers(0, 8))
    return can.Message(
        timestamp=draw(st.floats(0, 1e9)), arbitration_id=draw(st.integers(0, 2**29 - 1 if extended else 2**11 - 1)),
        is_extended_id=extended, is_remote_frame=kind == "remote", is_error_frame=kind == "error", is_fd=kind == "fd",
        bitrate_switch=kind == "fd" and draw(st.booleans()), error_state_indicator=kind == "fd" and draw(st.booleans()),
        is_rx=draw(st.booleans()), channel=draw(st.sampled_from(["can0", "can1", "0"])), dlc=length,
        data=None if kind == "remote" else draw(st.binary(min_size=length, max_size=length)),
    )  # fmt: skip


@settings(deadline=None)
@given(st.lists(messages(), max_size=20), st.integers(0, 20))
def test_messages_survive_the_arrays_and_a_split(given_messages: list[can.Message], cut: int) -> None:
    whole = frames_from_messages(given_messages)
    parts = join([frames_from_messages(given_messages[:cut]), frames_from_messages(given_messages[cut:])])
    for frames in (whole, parts):
        back = list(messages_from_frames(frames))
        assert len(back) == len(given_messages)
        for before, after in zip(given_messages, back, strict=True):
            assert after.equals(before, timestamp_delta=0.0)


def test_take_keeps_all_columns_together() -> None:
    frames = frames_from_messages(can.Message(timestamp=i, arbitration_id=i, data=[i]) for i in range(5))
    chosen = frames.take(frames.identifier % 2 == 0)
    assert chosen.time_s.tolist() == [0, 2, 4]
    assert chosen.data[:, 0].tolist() == [0, 2, 4]
    assert len(no_frames()) == 0


def test_arrays_that_do_not_fit_are_refused() -> None:
    with pytest.raises(AcquisitionError, match="identifier has shape"):
        Frames(
            np.zeros(2), np.zeros(1, np.uint32), np.zeros(2, np.uint8), np.zeros(2, np.uint8), np.zeros((2, 8), np.uint8),
            np.zeros(2, np.int16),
        )  # fmt: skip
    with pytest.raises(AcquisitionError, match="data has shape"):
        Frames(
            np.zeros(2), np.zeros(2, np.uint32), np.zeros(2, np.uint8), np.zeros(2, np.uint8), np.zeros((2, 7), np.uint8),
            np.zeros(2, np.int16),
        )  # fmt: skip
