import struct
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from lmeasure.acquisition import counter_fields
from lmeasure.acquisition.bus.feed import frames_from_counts
from lmeasure.acquisition.bus.frames import Frames, frames_from_messages
from lmeasure.acquisition.counters.decoders import ALL_BITS, CounterField, decode, encode
from lmeasure.core import AcquisitionError, FileFormatError
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import cell_rig

ORDERS = st.sampled_from(["little", "big"])


def rig_with(table: dict[str, Any]) -> Rig:
    data = cell_rig(0).to_dict()
    data["cable"] = data["cable"][:1]
    return rig_from_dict(data | {"can": table})


def field(first_bit: int, bits: int, order: Any = "little", signed: bool = True) -> CounterField:
    return CounterField("ch1", 0x181, ALL_BITS, False, first_bit, bits, order, signed, 2**bits)


@settings(deadline=None)  # the first call compiles
@given(
    st.binary(min_size=8, max_size=8), st.integers(0, 6), st.sampled_from([16, 24, 32, 64]), st.sampled_from(["little", "big"]),
    st.booleans(),
)  # fmt: skip
def test_whole_bytes_are_what_python_reads(data: bytes, offset: int, bits: int, order: Any, signed: bool) -> None:
    if offset + bits // 8 > 8:
        offset = 8 - bits // 8
    want = int.from_bytes(data[offset : offset + bits // 8], order, signed=signed)
    got = values_of(np.frombuffer(data, np.uint8), field(8 * offset, bits, order, signed))
    assert int(got[0]) % 2**64 == want % 2**64


@settings(deadline=None)  # the first call compiles
@given(st.binary(min_size=64, max_size=64), st.data(), ORDERS, st.booleans())
def test_odd_bit_fields_are_cut_and_put_back(data: bytes, draw: st.DataObject, order: Any, signed: bool) -> None:
    bits = draw.draw(st.integers(8, 64))
    first = draw.draw(st.integers(0, 512 - bits))
    f = field(first, bits, order, signed)
    number = int.from_bytes(data, order)
    want = (number >> first if order == "little" else number >> (512 - first - bits)) % 2**bits
    got = values_of(np.frombuffer(data, np.uint8), f)
    assert int(got[0]) % 2**bits == want
    if signed or bits < 64:
        assert (-(2 ** (bits - 1)) <= int(got[0]) < 2 ** (bits - 1)) if signed else (0 <= int(got[0]) < 2**bits)
    fresh = np.zeros((1, 64), np.uint8)
    encode(got, f, fresh)
    assert int(values_of(fresh[0], f)[0]) == int(got[0])
    assert np.unpackbits(fresh).sum() == bin(want).count("1")


def values_of(data: NDArray[np.uint8], f: CounterField) -> NDArray[np.int64]:
    frames = frames_from_messages([can.Message(arbitration_id=0x181, is_extended_id=False, is_fd=len(data) > 8, data=data.tobytes())])
    return decode(frames, (f,)).value


DBC = (Path(__file__).parent / "inputs" / "drums.dbc").read_text(encoding="utf-8")


@pytest.mark.parametrize(("message", "signal"), [("Drums", "Left"), ("Drums", "Right"), ("Wide", "Far")])
def test_signals_of_a_dbc_file_are_what_cantools_decodes(message: str, signal: str, tmp_path: Path) -> None:
    (tmp_path / "drums.dbc").write_text(DBC)
    rig = rig_with({"decoder": "dbc", "dbc": "drums.dbc", "channel": [{"channel": "ch1", "message": message, "signal": signal}]})
    fields = counter_fields(rig, folder=tmp_path)
    database: Any = cantools.database.load_file(str(tmp_path / "drums.dbc"))
    of = database.get_message_by_name(message)
    rng = np.random.default_rng(4)
    payloads = [rng.integers(0, 256, of.length, dtype=np.uint8).tobytes() for _ in range(200)]
    frames = frames_from_messages(
        can.Message(arbitration_id=of.frame_id, is_extended_id=of.is_extended_frame, data=p, is_fd=len(p) > 8) for p in payloads
    )
    want = [of.decode(p, decode_choices=False, scaling=False)[signal] for p in payloads]
    assert decode(frames, fields).value.tolist() == want


@pytest.mark.parametrize(
    ("channel", "complaint"),
    [
        ({"message": "Drum", "signal": "Left"}, "message 'Drum' is not in it"),
        ({"message": "Drums", "signal": "Middle"}, "has no signal 'Middle'. It has Left, Right"),
        ({"message": "Odd", "signal": "Tiny"}, "signal 'Tiny' has 4 bits, a counter has 8 to 64"),
    ],
)
def test_a_dbc_file_that_does_not_tell_is_refused(channel: dict[str, str], complaint: str, tmp_path: Path) -> None:
    (tmp_path / "drums.dbc").write_text(DBC)
    rig = rig_with({"decoder": "dbc", "dbc": "drums.dbc", "channel": [{"channel": "ch1"} | channel]})
    with pytest.raises(FileFormatError, match=complaint):
        counter_fields(rig, folder=tmp_path)
    (tmp_path / "drums.dbc").write_text("BO_ nonsense")
    with pytest.raises(FileFormatError, match="cannot be read as DBC"):
        counter_fields(rig, folder=tmp_path)
    with pytest.raises(FileFormatError, match="cannot be read"):
        counter_fields(rig, folder=tmp_path / "elsewhere")


def test_multiplexed_and_floating_point_signals_are_read_by_cantools(tmp_path: Path) -> None:
    (tmp_path / "drums.dbc").write_text(DBC + FLOATS)
    data = cell_rig(0).to_dict()
    data["cable"] = data["cable"][:4]
    channels = [
        {"channel": "ch1", "message": "Odd", "signal": "Sometimes"},
        {"channel": "ch2", "message": "Drums", "signal": "Left"},
        {"channel": "ch3", "message": "Real", "signal": "Single", "scale": 100.0, "start": 1},
        {"channel": "ch4", "message": "Real", "signal": "Mode"},
    ]
    fields = counter_fields(rig_from_dict(data | {"can": {"decoder": "dbc", "dbc": "drums.dbc", "channel": channels}}), folder=tmp_path)
    assert [f.reader is None for f in fields] == [False, True, False, True]
    assert (fields[2].start, fields[2].scale) == (100, 1.0)

    def real(value: float) -> bytes:
        return b"\7" + struct.pack(">f", value) + bytes(3)

    payloads = [
        (501, b"\1\x34\x12" + bytes(5)),  # the page that has the counter
        (501, b"\2\x34\x12" + bytes(5)),  # another page
        (0x80, b""),
        (500, bytes(8)),
        (502, real(12.34)),
        (502, real(float("nan"))),
        (502, real(float("inf"))),
        (501, b"\1"),
        (501, b"\1\x35\x12" + bytes(5)),
    ]
    frames = frames_from_messages(can.Message(arbitration_id=i, is_extended_id=False, data=p) for i, p in payloads)
    readings = decode(frames, fields, 0x80)
    assert readings.frame.tolist() == [0, 3, 4, 4, 5, 6, 8]
    assert readings.field.tolist() == [0, 1, 3, 2, 3, 3, 0]
    assert readings.value.tolist() == [0x1234, 0, 7, 1234, 7, 7, 0x1235]
    assert readings.window.tolist() == [0, 1, 1, 1, 1, 1, 1]
    assert [len(rows) for rows in readings.short] == [1, 0, 0, 0]
    with pytest.raises(AcquisitionError, match="channel ch1: multiplexed and floating-point signals can be read, not sent"):
        frames_from_counts(np.zeros(1), np.zeros((1, 4)), fields, 0x80)


FLOATS = """BO_ 502 Real: 8 ECU
 SG_ Mode : 0|8@1+ (1,0) [0|0] "" ECU
 SG_ Single : 15|32@0- (1,0) [0|0] "mm" ECU

SIG_VALTYPE_ 502 Single : 1;
"""


def test_a_floating_point_counter_does_not_wrap(tmp_path: Path) -> None:
    (tmp_path / "drums.dbc").write_text(DBC + FLOATS)
    data = cell_rig(0).to_dict()
    data["cable"] = data["cable"][:1]
    data["observation_point"][0]["drum"]["counter_bits"] = 32
    channel = {"channel": "ch1", "message": "Real", "signal": "Single"}
    with pytest.raises(AcquisitionError, match="is a floating-point number, which never wraps: its drum needs no counter_bits"):
        counter_fields(rig_from_dict(data | {"can": {"decoder": "dbc", "dbc": "drums.dbc", "channel": [channel]}}), folder=tmp_path)


def test_j1939_groups_are_found_whatever_their_priority_and_sender() -> None:
    table = {"decoder": "j1939", "channel": [{"channel": "ch1", "pgn": 0xFF12, "byte_order": "big", "bits": 16}]}
    fields = counter_fields(rig_with(table))
    ids = [0x18FF1280, 0x0CFF1203, 0x18FF1380, 0x19FF1280, 0x18FE1280]
    frames = frames_from_messages(can.Message(arbitration_id=i, is_extended_id=True, data=[1, 2, 0, 0, 0, 0, 0, 0]) for i in ids)
    assert decode(frames, fields).frame.tolist() == [0, 1]
    assert decode(frames, fields).value.tolist() == [258, 258]
    table["channel"] = [{"channel": "ch1", "pgn": 0xEF00, "source_address": 3}]
    fields = counter_fields(rig_with(table))
    ids = [0x18EF2103, 0x18EF2203, 0x18EF2104]
    frames = frames_from_messages(can.Message(arbitration_id=i, is_extended_id=True, data=bytes(8)) for i in ids)
    assert decode(frames, fields).frame.tolist() == [0, 1]


def test_error_remote_short_and_foreign_frames_carry_no_count() -> None:
    f = (field(0, 32),)
    frames: Frames = frames_from_messages(
        [
            can.Message(arbitration_id=0x181, is_extended_id=False, data=[1, 0, 0, 0]),
            can.Message(arbitration_id=0x181, is_extended_id=True, data=[2, 0, 0, 0]),
            can.Message(arbitration_id=0x181, is_extended_id=False, is_remote_frame=True, dlc=4),
            can.Message(arbitration_id=0x181, is_extended_id=False, is_error_frame=True, data=[3, 0, 0, 0]),
            can.Message(arbitration_id=0x181, is_extended_id=False, data=[4, 0, 0]),
            can.Message(arbitration_id=0x182, is_extended_id=False, data=[5, 0, 0, 0]),
        ]
    )
    readings = decode(frames, f)
    assert readings.value.tolist() == [1]
    assert [len(rows) for rows in readings.short] == [1]


def test_a_wider_counter_shows_by_its_carries() -> None:
    payloads = [int(v).to_bytes(4, "little") for v in range(65000, 66200, 100)]
    frames = frames_from_messages(can.Message(arbitration_id=0x181, is_extended_id=False, data=p) for p in payloads)
    for reported, fields in (((1,), (field(0, 16, signed=False),)), ((0,), (field(0, 32),))):
        for f in (frames, frames.take(slice(None, None, -1))):
            assert tuple(len(rows) for rows in decode(f, fields).wider) == reported


@pytest.mark.parametrize(
    ("channel", "complaint"),
    [({"range": 70000, "bits": 16}, "more than 16 bits can carry"), ({"range": 1000}, "but its drum states counter_bits = 16")],
)
def test_ranges_that_contradict_are_refused(channel: dict[str, Any], complaint: str) -> None:
    data = cell_rig(0).to_dict()
    data["cable"] = data["cable"][:1]
    data["observation_point"][0]["drum"]["counter_bits"] = 16
    rig = rig_from_dict(data | {"can": {"decoder": "raw", "channel": [{"channel": "ch1", "id": 1} | channel]}})
    with pytest.raises(AcquisitionError, match=complaint):
        counter_fields(rig)


@pytest.mark.parametrize(("sync_id", "extended"), [(0x80, False), (0x18FF0080, True)])
def test_a_sync_is_of_its_own_kind_of_identifier(sync_id: int, extended: bool) -> None:
    frames = frames_from_messages(
        [
            can.Message(arbitration_id=sync_id, is_extended_id=extended),
            can.Message(arbitration_id=0x80, is_extended_id=not extended),
            can.Message(arbitration_id=0x181, is_extended_id=False, data=[1, 0, 0, 0]),
            can.Message(arbitration_id=sync_id, is_extended_id=extended, is_remote_frame=True),
            can.Message(arbitration_id=sync_id, is_extended_id=extended),
        ]
    )
    readings = decode(frames, (field(0, 32),), sync_id)
    assert readings.sync.tolist() == [0, 4]
    assert readings.window.tolist() == [1]
