"""CiA 406 encoders on CANopen: found, asked who they are and how they count, held against the rig, and started.

Objects read over SDO: 1000h device type, 1001h error register, 1005h SYNC COB-ID, 1017h heartbeat, 1018h identity, 1800h and 1A00h with
what follows for the transmit PDOs, 6001h units per revolution, 6002h total range, 6200h cyclic timer, 6503h alarms.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lmeasure.acquisition.bus.canopen_objects import Objects, check_identity, position_place
from lmeasure.acquisition.counters.decoders import ALL_BITS, CounterField, field_at
from lmeasure.core import AcquisitionError
from lmeasure.rig import CanOpenCan, Drum, NodeChannel, Rig, SensorTable

if TYPE_CHECKING:
    import can

ENCODER_PROFILE = 406
ABSOLUTE_TYPES = (2, 8)
"""CiA 406, device type (1000h), upper half: multiturn absolute rotary and absolute linear encoders."""
BOOT_S = 0.3
"""How long nodes have to answer a scan."""


@dataclass(frozen=True)
class Device:
    """What an encoder says of itself; None where it has no such object."""

    channel: str
    node: int
    device_type: int
    vendor: int | None
    product: int | None
    revision: int | None
    serial: int | None
    units_per_revolution: int | None
    total_range: int | None
    cyclic_timer_ms: int | None
    heartbeat_ms: int | None
    error_register: int | None
    alarms: int | None
    field: CounterField

    def identity(self) -> dict[str, Any]:
        """For the recording's manifest: what is known, by name."""
        names = [n for n in self.__dataclass_fields__ if n != "field"]
        known = {n: getattr(self, n) for n in names if getattr(self, n) is not None}
        return known | {"cob_id": self.field.identifier, "bits": self.field.bits}


class _Node(Objects):
    """The objects of a node on the bus."""

    def __init__(self, network: Any, number: int, channel: str) -> None:
        import canopen

        self.name = f"node {number} (channel {channel})"
        self._sdo = network.add_node(canopen.RemoteNode(number, canopen.ObjectDictionary())).sdo  # type: ignore[no-untyped-call]

    def read(self, index: int, subindex: int = 0) -> int | None:
        """The object's value; AcquisitionError when the node does not answer."""
        from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

        try:
            return int.from_bytes(self._sdo.upload(index, subindex), "little")
        except SdoAbortedError:
            return None
        except SdoCommunicationError as error:
            raise AcquisitionError(f"{self.name}: no answer to {index:04X}h:{subindex}: {error}") from error


def start_nodes(bus: "can.BusABC", rig: Rig, passage: int = 1, folder: Path = Path()) -> tuple[Device, ...]:
    """Find, check and start the encoders of the rig's CiA 406 table over an open bus; the devices in the cables' order.

    folder: where the table's EDS file stands. AcquisitionError names the node, its channel and what does not agree with the rig.
    """
    import can
    import canopen

    table = rig.can_table
    if not isinstance(table, CanOpenCan):
        raise AcquisitionError(f"rig {rig.name!r}: its decoder is {table.decoder!r}, not 'cia406'")
    channels = {c.channel: c for c in table.channel}
    drums = rig.counters_of(passage)
    network = canopen.Network(bus)
    network.notifier = can.Notifier(bus, network.listeners, timeout=0.05)
    try:
        present = scan(network)
        missing = [channels[name] for name in drums if channels[name].node not in present]
        if missing:
            found = f"on the bus: {', '.join(map(str, present))}" if present else "no node answers at all"
            raise AcquisitionError(f"node {missing[0].node} (channel {missing[0].channel}) does not answer; {found}")
        devices = tuple(_device(network, channels[name], drum, table) for name, drum in drums.items())
        _check_serials(devices, channels)
        if table.eds is not None:
            for d in devices:
                check_identity(folder / table.eds, f"node {d.node} (channel {d.channel})", d.node, vendor=d.vendor, product=d.product)
        for device in devices:
            network.send_message(0, bytes([1, device.node]))  # NMT: start
        return devices
    finally:
        network.notifier.stop(timeout=1.0)
        network.bus = None  # it stays open


def scan(network: Any) -> list[int]:
    """Nodes that answer a read of their device type, or say anything else."""
    network.scanner.reset()
    network.scanner.search()
    time.sleep(BOOT_S)
    return sorted(network.scanner.nodes)


def _device(network: Any, wanted: NodeChannel, drum: Drum | SensorTable, table: CanOpenCan) -> Device:
    node = _Node(network, wanted.node, wanted.channel)
    device_type = node.need(0x1000)
    if device_type & 0xFFFF != ENCODER_PROFILE:
        raise AcquisitionError(f"{node.name}: its device profile is {device_type & 0xFFFF}, not that of encoders, {ENCODER_PROFILE}")
    units, total = node.read(0x6001), node.read(0x6002)
    want = drum.scale * drum.counts_per_revolution
    if units is not None and wanted.scale * units != want:
        raise AcquisitionError(f"{node.name}: counts {wanted.scale * units:g} per revolution (6001h), the rig says {want:g}")
    if total and wanted.range and total != wanted.range:
        raise AcquisitionError(f"{node.name}: its range is {total} units (6002h), the rig says range = {wanted.range}")
    sync_id = node.read(0x1005)
    if table.timing == "sync" and sync_id is not None and sync_id & ALL_BITS != table.sync_id:
        raise AcquisitionError(f"{node.name}: listens to SYNC {sync_id & ALL_BITS:#x} (1005h), the rig says sync_id = {table.sync_id:#x}")
    place = position_place(node, table.timing, node.read(0x6200))
    if wanted.cob_id is not None and (wanted.cob_id, 8 * wanted.byte_offset, wanted.bits) != (place[0], *place[3:5]):
        stated = f"cob_id = {wanted.cob_id:#x}, byte {wanted.byte_offset}, {wanted.bits} bits"
        raise AcquisitionError(f"{node.name}: sends its position in {place[0]:#x}, bit {place[3]}, {place[4]} bits, the rig says {stated}")
    known = {"range": total} if total else {}
    ranged = wanted.model_copy(update=known | ({"absolute": True} if device_type >> 16 in ABSOLUTE_TYPES else {}))
    return Device(
        channel=wanted.channel,
        node=wanted.node,
        device_type=device_type,
        vendor=node.read(0x1018, 1),
        product=node.read(0x1018, 2),
        revision=node.read(0x1018, 3),
        serial=node.read(0x1018, 4),
        units_per_revolution=units,
        total_range=total,
        cyclic_timer_ms=node.read(0x6200),
        heartbeat_ms=node.read(0x1017),
        error_register=node.read(0x1001),
        alarms=node.read(0x6503),
        field=field_at(ranged, place, drum),
    )


def _check_serials(devices: tuple[Device, ...], channels: dict[str, NodeChannel]) -> None:
    """The rig's serial numbers, where it has any: two encoders may have changed places."""
    for device in devices:
        want = channels[device.channel].serial
        if want is None or device.serial == want:
            continue
        other = next((d for d in devices if d.serial == want), None)
        swapped = f"; that one is node {other.node} (channel {other.channel}): they have changed places" if other else ""
        raise AcquisitionError(
            f"node {device.node} (channel {device.channel}): its serial number is {device.serial}, the rig says {want}{swapped}"
        )


def produce_sync(bus: "can.BusABC", sync_id: int, period_s: float) -> Any:
    """Send SYNC with that period from now on: by the interface where it can, else from a thread; a task with `stop()`.

    AcquisitionError when the interface does not give its own frames back: then nobody could tell which counts belong to which SYNC.
    """
    import can

    message = can.Message(arbitration_id=sync_id, is_extended_id=sync_id > 0x7FF)
    bus.send(message)
    end = time.monotonic() + 1.0
    while (left := end - time.monotonic()) > 0:
        got = bus.recv(left)
        if got is not None and got.arbitration_id == sync_id:
            return bus.send_periodic(message, period_s)
    raise AcquisitionError(
        "the interface does not give back the SYNC that it sends; let a device produce it, and leave sync_period_ms out of the rig"
    )
