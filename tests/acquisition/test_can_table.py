from typing import Any

import pytest

from lmeasure.core import RigError
from lmeasure.rig import RawCan, Rig, rig_from_dict

POINT = {
    "name": "B1",
    "position_mm": [1000.0, 0.0, 500.0],
    "guide_alpha_deg": 45.0,
    "guide_beta_deg": 90.0,
    "pulley_radius_mm": 20.0,
    "drum": {
        "counts_per_revolution": 6000, "count_length_mm": 0.012, "groove_pitch_mm": 1.0, "tangent_length_mm": 180.0,
        "axial_offset_mm": 25.0,
    },
}  # fmt: skip
RIG: dict[str, Any] = {
    "schema": "lmeasure.rig/1", "unstated": "exact", "name": "one", "observation_point": [POINT], "tool": {"P1": [0.0, 0.0, 0.0]},
    "cable": [{"name": "c1", "channel": "ch1", "from": "B1", "to": "P1"}],
}  # fmt: skip


def with_can(**table: Any) -> Rig:
    return rig_from_dict(RIG | {"can": table}, "rig.toml")


def test_a_rig_without_a_table_has_the_frames_of_cia_406() -> None:
    table = rig_from_dict(RIG).can_table
    assert isinstance(table, RawCan)
    assert (table.channel[0].id, table.channel[0].bits, table.channel[0].signed, table.sync_id) == (0x181, 32, True, 0x80)
    assert "can" not in rig_from_dict(RIG).to_dict()


def test_a_table_is_written_as_it_was_read() -> None:
    rig = with_can(decoder="raw", channel=[{"channel": "ch1", "id": 0x18FF0001, "extended": True, "byte_order": "big", "bits": 24}])
    assert rig_from_dict(rig.to_dict()) == rig


@pytest.mark.parametrize(
    ("table", "complaint"),
    [
        ({"decoder": "raw", "channel": [{"channel": "ch1", "id": 0x800}]}, "[can.channel ch1].id: 0x800 has more than 11 bits"),
        ({"decoder": "raw", "channel": [{"channel": "ch1", "id": 1, "bits": 12}]}, "[can.channel ch1].bits: must be 16, 24, 32 or 64"),
        ({"decoder": "raw", "channel": [{"channel": "ch1", "id": 1, "byte_offset": 62}]}, "32 bits from byte 62 do not fit a frame"),
        ({"decoder": "raw", "channel": [{"channel": "ch1", "id": 1, "byteorder": "big"}]}, "Did you mean 'byte_order'"),
        ({"decoder": "raw", "channel": [{"channel": "ch2", "id": 1}]}, "channel 'ch1' of the rig is missing"),
        ({"decoder": "raw", "channel": [{"channel": "ch1", "id": 1}, {"channel": "ch1", "id": 2}]}, "channel 'ch1' is given 2 times"),
        ({"decoder": "cia406", "channel": [{"channel": "ch1", "node": 128}]}, "[can.channel ch1].node: must be at most 127"),
        ({"decoder": "modbus", "channel": []}, "'raw', 'dbc', 'cia406', 'j1939'"),
        ({"decoder": "j1939", "channel": [{"channel": "ch1", "pgn": 65280, "byte_offset": 6}]}, "32 bits from byte 6 do not fit a frame"),
    ],
)
def test_a_wrong_table_is_refused_in_one_line(table: dict[str, Any], complaint: str) -> None:
    with pytest.raises(RigError) as refused:
        with_can(**table)
    assert complaint in str(refused.value)
    assert str(refused.value).startswith(("rig.toml: can", "rig.toml: [can"))
    assert "\n" not in str(refused.value)
