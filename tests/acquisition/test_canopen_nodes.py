"""CiA 406 encoders on a bus: found, asked, held against the rig, started; and what is said when they are not what the rig says."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from can_devices import Encoders

from lmeasure import files
from lmeasure.acquisition.feed import virtual_place
from lmeasure.acquisition.recorder import Recording, record
from lmeasure.acquisition.session import Link, connect
from lmeasure.counts import Counts, read_counts
from lmeasure.errors import AcquisitionError
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import cell_rig

BOTH: list[dict[str, Any]] = [{"channel": "ch1", "node": 5}, {"channel": "ch2", "node": 9}]


def rig_of(drum: dict[str, Any] | None = None, channels: list[dict[str, Any]] | None = None, **table: Any) -> Rig:
    """Two cables of the cell on nodes 5 and 9."""
    data = cell_rig(0).to_dict()
    data["cable"] = data["cable"][:2]
    for point in data["observation_point"]:
        point["drum"] |= {"max_cable_speed_mm_s": 200.0} | (drum or {})
    return rig_from_dict(data | {"can": {"decoder": "cia406", "channel": channels or BOTH} | table})


def row(k: int, node: int) -> int:
    """Position of a node at the k-th SYNC."""
    return 1000 * node + (3 if node == 5 else -7) * k


@contextmanager
def encoders(**settings: int) -> Iterator[tuple[str, Encoders]]:
    """Nodes 5 and 9 on a virtual bus: its name, and the encoders."""
    place = virtual_place()
    devices = Encoders(can.Bus(interface="virtual", channel=place), row, {5: settings, 9: settings})
    try:
        yield place, devices
    finally:
        devices.close()


def record_some(rig: Rig, place: str, folder: Path, count: int, devices: Encoders | None) -> tuple[Recording, Link, Counts]:
    """Record until the devices have produced so many SYNCs, or, without them, for half a second."""
    link = connect(rig, folder, f"virtual:{place}")
    ended = threading.Event()

    def produce() -> None:
        while devices is not None and not devices.started():
            time.sleep(0.01)
        if devices is not None:
            devices.produce_sync(count, 0.005)
        time.sleep(0.5)
        ended.set()

    thread = threading.Thread(target=produce)
    thread.start()
    try:
        identities = [d.identity() for d in link.devices]
        recording = record(rig, link.source, link.fields, folder / "run", devices=identities, stop=ended.is_set)
    finally:
        thread.join()
        link.source.close()
    return recording, link, read_counts(folder / "run" / "pass1.csv")


@pytest.mark.parametrize("lead", [0, 1])
def test_the_mapping_is_read_from_the_devices(lead: int, tmp_path: Path) -> None:
    rig = rig_of(channels=[BOTH[0] | {"start": 5000}, BOTH[1]])
    with encoders(lead=lead, range=36000) as (place, devices):
        recording, link, counts = record_some(rig, place, tmp_path, 100, devices)
    fields = [d.field for d in link.devices]
    assert [(f.identifier, f.first_bit, f.modulus) for f in fields] == [(0x285, 16 * lead, 36000), (0x289, 16 * lead, 36000)]
    np.testing.assert_array_equal(counts.recorded, [[row(k, 5) - 5000, row(k, 9)] for k in range(100)])
    said = files.read_toml(tmp_path / "run" / "run.toml")["recording"][0]["devices"]
    assert said[1] == {
        "channel": "ch2",
        "node": 9,
        "device_type": 0x20196,
        "vendor": 0x1234,
        "product": 77,
        "revision": 3,
        "serial": 9009,
        "units_per_revolution": 6000,
        "total_range": 36000,
        "cyclic_timer_ms": 0,
        "heartbeat_ms": 0,
        "error_register": 0,
        "cob_id": 0x289,
        "bits": 32,
    }
    assert recording.faults == {}


def test_this_program_can_produce_the_sync(tmp_path: Path) -> None:
    with encoders(sync_id=0x85) as (place, _):
        _, link, got = record_some(rig_of(sync_period_ms=20.0, sync_id=0x85), place, tmp_path, 100, None)
    # the nodes count the SYNCs they saw; how many there were is the host's affair
    present = got.recorded[np.isfinite(got.recorded).all(axis=1)]
    assert len(present) > 10
    np.testing.assert_array_equal(np.diff(present[:, 0]) / 3, np.diff(present[:, 1]) / -7)
    assert link.devices[0].serial == 9005


@pytest.mark.parametrize(
    ("settings", "rig", "complaint"),
    [
        (
            {},
            rig_of(channels=[BOTH[0], BOTH[1] | {"node": 8}]),
            "node 8 .channel ch2. does not answer; on the bus: 5, 9",
        ),
        ({"device_type": 0x191}, rig_of(), "its device profile is 401, not that of encoders, 406"),
        ({"units": 4096}, rig_of(), "counts 4096 per revolution .6001h., the rig says 6000"),
        (
            {"range": 65536},
            rig_of(channels=[BOTH[0] | {"range": 36000}, BOTH[1]]),
            "range is 65536 units",
        ),
        ({"range": 36000}, rig_of({"counter_bits": 16}), "counts 36000 counts, but its drum says counter_bits = 16"),
        ({"sync_id": 0x85}, rig_of(), "listens to SYNC 0x85 .1005h., the rig says sync_id = 0x80"),
        ({"sync_type": 254}, rig_of(), "no transmit PDO sends its position after each SYNC; it is in TPDO1 of type 254, TPDO2 of type 254"),
        ({}, rig_of(timing="free"), "its timer is off .6200h"),
        (
            {},
            rig_of(channels=[BOTH[0] | {"serial": 9009}, BOTH[1] | {"serial": 9005}]),
            "its serial number is 9005, the rig says 9009; that one is node 9 .channel ch2.: they have changed places",
        ),
    ],
)
def test_devices_that_are_not_what_the_rig_says_are_refused(settings: dict[str, int], rig: Rig, complaint: str, tmp_path: Path) -> None:
    with encoders(**settings) as (place, _), pytest.raises(AcquisitionError, match=complaint) as refused:
        connect(rig, tmp_path, f"virtual:{place}")
    assert "\n" not in str(refused.value)


def test_an_empty_bus_and_a_log_have_nobody_to_ask(tmp_path: Path) -> None:
    with pytest.raises(AcquisitionError, match=r"node 5 .channel ch1. does not answer; no node answers at all"):
        connect(rig_of(), tmp_path, f"virtual:{virtual_place()}")
    with pytest.raises(AcquisitionError, match="'cia406' asks the encoders where they put their counts"):
        connect(rig_of(), tmp_path, "replay:drive.blf")


def test_a_timer_of_its_own_is_enough_when_the_rig_says_free(tmp_path: Path) -> None:
    with encoders(timer_ms=10) as (place, _):
        link = connect(rig_of(timing="free"), tmp_path, f"virtual:{place}")
        link.source.close()
    assert [d.field.identifier for d in link.devices] == [0x185, 0x189]
