"""CiA 406 encoders on a bus: found, asked, held against the rig, started; and what is said when they are not what the rig says."""

import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from can_devices import Encoders

from lmeasure.acquisition import Link, Recording, connect, import_logs, record, record_session, write_import
from lmeasure.acquisition.bus.feed import virtual_place
from lmeasure.acquisition.bus.sources import BusSource
from lmeasure.core import AcquisitionError, FileFormatError, LMeasureError
from lmeasure.io import files
from lmeasure.recording import Counts, read_counts
from lmeasure.rig import CanOpenCan, Rig, read_rig, rig_from_dict, write_rig
from lmeasure.simulation import cell_rig

pytestmark = pytest.mark.live

START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
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
def encoders_at(place: str, settings: dict[str, int], serials: tuple[int, int] = (9005, 9009)) -> Iterator[tuple[str, Encoders]]:
    """Nodes 5 and 9 on a virtual bus: its name, and the encoders."""
    nodes = {n: settings | {"serial": serial} for n, serial in zip((5, 9), serials, strict=True)}
    devices = Encoders(can.Bus(interface="virtual", channel=place), row, nodes)
    try:
        yield place, devices
    finally:
        devices.close()


def encoders(**settings: int) -> AbstractContextManager[tuple[str, Encoders]]:
    """Nodes 5 and 9 on a virtual bus of their own."""
    return encoders_at(virtual_place(), settings)


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
        "channel": "ch2", "node": 9, "device_type": 0x20196, "vendor": 0x1234, "product": 77, "revision": 3, "serial": 9009,
        "units_per_revolution": 6000, "total_range": 36000, "cyclic_timer_ms": 0, "heartbeat_ms": 0, "error_register": 0, "cob_id": 0x289,
        "bits": 32,
    }  # fmt: skip
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
        ({}, rig_of(channels=[BOTH[0], BOTH[1] | {"node": 8}]), "node 8 .channel ch2. does not answer .on the bus: 5, 9."),
        ({"device_type": 0x191}, rig_of(), "its device profile is 401, not that of encoders, 406"),
        ({"units": 4096}, rig_of(), "counts 4096 per revolution .6001h., but the rig states 6000"),
        ({"range": 65536}, rig_of(channels=[BOTH[0] | {"range": 36000}, BOTH[1]]), "range is 65536 units"),
        ({"range": 36000}, rig_of({"counter_bits": 16}), "counts 36000 counts, but its drum states counter_bits = 16"),
        ({"sync_id": 0x85}, rig_of(), "listens to SYNC 0x85 .1005h., but the rig states sync_id = 0x80"),
        (
            {"sync_type": 254},
            rig_of(),
            "no transmit PDO sends its position after each SYNC .it is in TPDO1 of type 254, TPDO2 of type 254.",
        ),
        ({}, rig_of(timing="free"), "its timer is off .6200h"),
        ({}, rig_of(channels=[BOTH[0] | {"cob_id": 0x185}, BOTH[1]]), "in 0x285, bit 0, 32 bits, but the rig states cob_id = 0x185"),
        (
            {},
            rig_of(channels=[BOTH[0] | {"serial": 9009}, BOTH[1] | {"serial": 9005}]),
            "is 9005, but the rig states 9009; that one is node 9 .channel ch2.: the two are swapped",
        ),
    ],
)
def test_devices_that_are_not_what_the_rig_says_are_refused(settings: dict[str, int], rig: Rig, complaint: str, tmp_path: Path) -> None:
    with encoders(**settings) as (place, _), pytest.raises(AcquisitionError, match=complaint) as refused:
        connect(rig, tmp_path, f"virtual:{place}")
    assert "\n" not in str(refused.value)


def test_two_encoders_that_come_back_in_each_others_places_end_the_recording(tmp_path: Path) -> None:
    with encoders() as (place, devices):
        link = connect(rig_of(), tmp_path, f"virtual:{place}")
        devices.produce_sync(20, 0.005)
    source = link.source
    assert isinstance(source, BusSource)
    source._patience_s = 1.0
    with encoders_at(place, {}, (9009, 9005)):
        source.bus.shutdown()  # the power goes, and comes back to plugs that were exchanged
        try:
            recording = record(rig_of(), source, link.fields, tmp_path / "run", seconds=20.0)
        finally:
            source.close()
    assert "node 5 (channel ch1): came back as another device: serial number 9009, before 9005" in recording.ended
    assert recording.samples > 0


def test_an_empty_bus_and_a_simulated_cell_have_nobody_to_ask(tmp_path: Path) -> None:
    with pytest.raises(AcquisitionError, match=r"node 5 .channel ch1. does not answer .no node answers at all."):
        connect(rig_of(), tmp_path, f"virtual:{virtual_place()}")
    with pytest.raises(AcquisitionError, match=r"need CANopen .decoder 'cia406'., which the simulated cell does not have"):
        connect(rig_of(), tmp_path, "simulated:scenario.toml")


def answers_log(path: Path, first_id: int, lead: bytes = b"") -> Path:
    """A log of SYNC and the answers of nodes 5 and 9."""
    with can.Logger(str(path)) as log:
        for k in range(100):
            t = 1_700_000_000 + 0.01 * k
            log(can.Message(timestamp=t, arbitration_id=0x80, is_extended_id=False, channel=0))
            for node in (5, 9):
                data = lead + (row(k, node) % 2**32).to_bytes(4, "little")
                log(can.Message(timestamp=t + 1e-3, arbitration_id=first_id + node, is_extended_id=False, channel=0, data=data))
    return path


@pytest.mark.parametrize("first_id", [0x180, 0x280])
def test_a_log_has_nobody_to_ask_and_holds_the_pdo_of_the_profile(first_id: int, tmp_path: Path) -> None:
    log = answers_log(tmp_path / "drive.blf", first_id)
    imported = import_logs([log], rig_of(), START)
    np.testing.assert_array_equal(imported.run.passes[0].recorded, [[row(k, 5), row(k, 9)] for k in range(100)])
    # what was found stands in the run's rig
    write_import(tmp_path / "run", imported)
    kept = read_rig(tmp_path / "run" / "rig.toml").can
    assert isinstance(kept, CanOpenCan)
    assert [(c.cob_id, c.byte_offset, c.bits) for c in kept.channel] == [(first_id + 5, 0, 32), (first_id + 9, 0, 32)]


def test_a_log_without_the_encoders_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(
        AcquisitionError, match=r"drive\.blf: channel ch1: not one count in frames 285. Identifiers in the log: 080, 385, 389"
    ):
        import_logs([answers_log(tmp_path / "drive.blf", 0x380)], rig_of(), START)


def test_a_recording_of_encoders_is_read_again_from_its_log(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.toml", rig_of(channels=[BOTH[0] | {"start": 5000}, BOTH[1]]))
    with encoders(lead=1, range=36000) as (place, devices):
        thread = threading.Thread(target=_answer, args=(devices,))
        thread.start()
        record_session(tmp_path / "rig.toml", f"virtual:{place}", tmp_path / "run", seconds=1.5)
        thread.join()
    recorded = read_counts(tmp_path / "run" / "pass1.csv").recorded
    assert len(recorded) > 50
    again = import_logs([tmp_path / "run" / "pass1.log"], read_rig(tmp_path / "run" / "rig.toml"), START)
    np.testing.assert_array_equal(again.run.passes[0].recorded, recorded)
    record_session(tmp_path / "run" / "rig.toml", f"replay:{tmp_path / 'run' / 'pass1.log'}", tmp_path / "replayed", paced=False)
    np.testing.assert_array_equal(read_counts(tmp_path / "replayed" / "pass1.csv").recorded, recorded)


def _answer(devices: Encoders) -> None:
    while not devices.started():
        time.sleep(0.01)
    devices.produce_sync(100, 0.005)


ENTRIES = {
    "1018sub1": "0x1234", "1018sub2": "77", "1801sub1": "$NODEID+0x380", "1801sub2": "1", "1A01sub0": "2", "1A01sub1": "0x65000010",
    "1A01sub2": "0x60040020",
}  # fmt: skip
EDS = "[DeviceInfo]\nVendorNumber=0x1234\n[1018]\n[1801]\n[1A01]\n"
EDS += "".join(f"[{entry}]\nDefaultValue={value}\n" for entry, value in ENTRIES.items())


def test_a_data_sheet_says_where_the_counts_are(tmp_path: Path) -> None:
    (tmp_path / "encoder.eds").write_text(EDS)
    log = answers_log(tmp_path / "drive.blf", 0x380, b"\xab\xcd")
    imported = import_logs([log], rig_of(eds="encoder.eds"), START, folder=tmp_path)
    np.testing.assert_array_equal(imported.run.passes[0].recorded, [[row(k, 5), row(k, 9)] for k in range(100)])
    with encoders() as (place, _):
        link = connect(rig_of(eds="encoder.eds"), tmp_path, f"virtual:{place}")
        link.source.close()
    (tmp_path / "other.eds").write_text(EDS.replace("DefaultValue=77", "DefaultValue=78"))
    with (
        encoders() as (place, _),
        pytest.raises(AcquisitionError, match=r"node 5 .channel ch1.: its product is 0x4d .1018h:2., .*describes 0x4e"),
    ):
        connect(rig_of(eds="other.eds"), tmp_path, f"virtual:{place}")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("no data sheet", r"is no EDS file"),
        (
            EDS.replace("0x60040020", "0x60300010"),
            "no transmit PDO sends its position after each SYNC .no valid one has 6004h or 6008h mapped.",
        ),
        (EDS.replace("0x60040020", "nonsense"), "has no object 1A01h:2|is no EDS file"),
    ],
)
def test_a_data_sheet_that_does_not_tell_is_refused(text: str, complaint: str, tmp_path: Path) -> None:
    (tmp_path / "encoder.eds").write_text(text)
    log = answers_log(tmp_path / "drive.blf", 0x380)
    with pytest.raises(LMeasureError, match=complaint) as refused:
        import_logs([log], rig_of(eds="encoder.eds"), START, folder=tmp_path)
    assert "\n" not in str(refused.value)
    with pytest.raises(FileFormatError, match=r"absent\.eds: cannot be read"):
        import_logs([log], rig_of(eds="absent.eds"), START, folder=tmp_path)


def test_a_timer_of_its_own_is_enough_when_the_rig_says_free(tmp_path: Path) -> None:
    with encoders(timer_ms=10) as (place, _):
        link = connect(rig_of(timing="free"), tmp_path, f"virtual:{place}")
        link.source.close()
    assert [d.field.identifier for d in link.devices] == [0x185, 0x189]
