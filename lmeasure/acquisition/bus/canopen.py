"""Objects of an encoder about its frames: read from the device, from its electronic data sheet (EDS), or from the rig, for a log."""

import itertools
import re
import time
from abc import ABC, abstractmethod
from collections.abc import Collection
from configparser import Error as ParserError, RawConfigParser
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lmeasure.acquisition.counters.decoders import ALL_BITS, CounterField, Place, field_at
from lmeasure.core import AcquisitionError, FileFormatError
from lmeasure.io import read_regular
from lmeasure.rig import CanOpenCan, Drum, NodeChannel, Rig, SensorTable
from lmeasure.text import joined, message

if TYPE_CHECKING:
    import can


POSITIONS = {0x6004: "position value", 0x6008: "64-bit position value"}
LAST_SYNC_TYPE = 240
"""Transmission types from 1 (0: acyclic) up to here are sent after a SYNC."""
PDO_INVALID, EXTENDED_COB = 1 << 31, 1 << 29
TRANSMIT_PDOS = 8
LARGEST_SHEET = 1 << 24
OBJECT = re.compile(r"[0-9a-f]{4}", re.IGNORECASE)
HEXADECIMAL, DECIMAL = re.compile(r"0X[0-9A-F]+"), re.compile(r"[0-9]+")
OWN_TIMER_PDO, SYNC_PDO = 0x180, 0x280
"""CiA 406: TPDO1 is sent by the device's own timer, TPDO2 after SYNC; the node's number is added."""


class Objects(ABC):
    """An encoder's objects as numbers, wherever they come from."""

    name: str

    @abstractmethod
    def read(self, index: int, subindex: int = 0) -> int | None:
        """The object's value, unsigned; None when there is none."""

    def need(self, index: int, subindex: int = 0) -> int:
        """A value that must be there."""
        value = self.read(index, subindex)
        if value is None:
            raise AcquisitionError(message("error.has_no_object_h", where=self.name, index=index, subindex=subindex))
        return value


class DataSheet(Objects):
    """The numbers that an EDS or DCF file (CiA 306) states: its parameter values, else its defaults; `$NODEID` is the node's number.

    Only requested objects are read: other entries may be odd or blank. A transmit PDO with a blank identifier or type has those of CiA 301
    and CiA 406. FileFormatError when the file cannot be read, or a required value is no number.
    """

    def __init__(self, path: Path, node: int) -> None:
        self.name, self._path, self._node = f"{path}: node {node}", path, node
        parser = RawConfigParser(delimiters=("=",), inline_comment_prefixes=(";",), strict=False, allow_no_value=True)
        try:
            lines = read_regular(path, LARGEST_SHEET).decode("utf-8-sig", "replace").splitlines()
            parser.read_string("\n".join(line.strip() for line in lines))  # an indented line would continue the one before
        except ParserError as error:
            raise FileFormatError(message("error.is_no_eds_file_2", where=path, error=" ".join(str(error).split())[:200])) from error
        self._sections: dict[str, dict[str, str | None]] = {name.lower(): dict(parser[name]) for name in parser.sections()}
        if not any(OBJECT.fullmatch(name) for name in self._sections):
            raise FileFormatError(message("error.is_no_eds_file", where=path))

    def read(self, index: int, subindex: int = 0) -> int | None:
        """Return the object's value; None when the file has none."""
        whole = self._sections.get(f"{index:04x}", {})
        own: dict[str, str | None] | None = self._sections.get(f"{index:04x}sub{subindex:x}")
        if own is None and subindex == 0 and "subnumber" not in whole and "compactsubobj" not in whole:
            own = whole
        if own is None and whole.get("compactsubobj"):
            values = self._sections.get(f"{index:04x}value", {})
            own = {"defaultvalue": whole["compactsubobj"]} if subindex == 0 else whole | {"parametervalue": values.get(str(subindex))}
        if own is None:
            return None
        for key in ("parametervalue", "defaultvalue"):
            if (text := own.get(key) or "").strip():
                return self._number(text, f"{index:04X}h:{subindex}")
        return self._blank(index, subindex)

    def _blank(self, index: int, subindex: int) -> int | None:
        """Return the default of the standards for an object that exists but has no value."""
        if 0x1800 <= index < 0x1804 and subindex == 1:
            return OWN_TIMER_PDO + 0x100 * (index - 0x1800) + self._node
        if index in (0x1800, 0x1801) and subindex == 2:
            return 254 if index == 0x1800 else 1
        if 0x1A00 <= index < 0x1A00 + TRANSMIT_PDOS and subindex == 0:
            return next(n for n in itertools.count() if not self._sections.get(f"{index:04x}sub{n + 1:x}", {}).get("defaultvalue"))
        return None

    def _number(self, text: str, what: str) -> int | None:
        """A sum of numbers of CiA 306 (0x: hexadecimal, a leading 0: octal) and $NODEID; None for a text that is no number."""
        total = 0
        for part in text.replace(" ", "").upper().split("+"):
            if part == "$NODEID":
                total += self._node
            elif HEXADECIMAL.fullmatch(part):
                total += int(part, 16)
            elif DECIMAL.fullmatch(part):
                digits = part.lstrip("0") or "0"
                if len(digits) < len(part) and len(digits) > 1 and not set(digits) & {"8", "9"}:
                    raise FileFormatError(message("error.may_be_octal_or", where=self._path, what=what, text=text))
                total += int(digits)
            else:
                return None
        return total


def position_place(node: Objects, timing: str, cyclic_ms: int | None) -> Place:
    """Return the place of the position in the PDO that the table's timing selects: identifier, mask, extended, first bit, bits, ..."""
    seen = []
    for number in range(TRANSMIT_PDOS):
        cob = node.read(0x1800 + number, 1)
        if cob is None or cob & PDO_INVALID:
            continue
        kind = node.need(0x1800 + number, 2)
        first_bit = 0
        for entry in range(1, node.need(0x1A00 + number) + 1):
            value = node.need(0x1A00 + number, entry)
            index, bits = value >> 16, value & 0xFF
            if index in POSITIONS and bits <= 64:
                seen.append(message("bus.pdo_of_type", number=number + 1, kind=kind))
                if (1 <= kind <= LAST_SYNC_TYPE) == (timing == "sync"):
                    timer = node.read(0x1800 + number, 5)
                    if timing == "free" and not timer and not cyclic_ms:
                        raise AcquisitionError(message("error.its_timer_is_off", where=node.name))
                    return cob & ALL_BITS, ALL_BITS, bool(cob & EXTENDED_COB), first_bit, bits, "little", False
            first_bit += bits
    where = message("bus.position_in", pdos=tuple(seen)) if seen else message("bus.position_not_mapped")
    raise AcquisitionError(message("bus.no_pdo_at_sync" if timing == "sync" else "bus.no_pdo_by_timer", node=node.name, where=where))


def check_identity(sheet: Path, name: str, node: int, *, vendor: int | None, product: int | None) -> None:
    """AcquisitionError where a device is not of the vendor or product that its EDS file describes (1018h)."""
    described = DataSheet(sheet, node)
    for subindex, what, value in ((1, "vendor", vendor), (2, "product", product)):
        want = described.read(0x1018, subindex)
        if want and value is not None and value != want:
            raise AcquisitionError(
                message("error.its_is_1018h_describes", where=name, what=what, value=value, subindex=subindex, sheet=sheet, want=want)
            )


def fields_in_log(rig: Rig, passage: int, folder: Path, seen: Collection[int]) -> tuple[CounterField, ...]:
    """Return the fields of a CiA 406 rig's channels in a log, where no device answers; seen: 11-bit identifiers of its frames.

    The rig gives the place (cob_id), else the EDS file, else it is the PDO that CiA 406 names for the table's timing, or in TPDO1 where the
    log has that one only. FileFormatError if the EDS file does not state it.
    """
    table = rig.can_table
    if not isinstance(table, CanOpenCan):
        raise AcquisitionError(message("error.rig_its_decoder_is", name=rig.name, decoder=table.decoder))
    channels = {c.channel: c for c in table.channel}
    drums = rig.counters_of(passage)
    return tuple(field_at(channels[n], _place_in_log(channels[n], table, folder, seen), drum) for n, drum in drums.items())


def _place_in_log(channel: NodeChannel, table: CanOpenCan, folder: Path, seen: Collection[int]) -> Place:
    if channel.cob_id is None and table.eds is not None:
        # the timer is set in the device, whatever the sheet's default
        return position_place(DataSheet(folder / table.eds, channel.node), table.timing, 1)
    own_timer, at_sync = OWN_TIMER_PDO + channel.node, SYNC_PDO + channel.node
    named = at_sync if table.timing == "sync" and (at_sync in seen or own_timer not in seen) else own_timer
    cob_id = named if channel.cob_id is None else channel.cob_id
    return cob_id, ALL_BITS, cob_id > 0x7FF, 8 * channel.byte_offset, channel.bits, "little", False


def as_mapped(rig: Rig, fields: tuple[CounterField, ...]) -> Rig:
    """Return the rig with the frames and ranges found for its encoders, so that recorded frames can be read without a device."""
    table = rig.can
    if not isinstance(table, CanOpenCan):
        return rig
    found = {
        f.channel: {"cob_id": f.identifier, "byte_offset": f.first_bit // 8, "bits": f.bits, "range": f.modulus}
        | ({"absolute": True} if f.absolute else {})
        for f in fields
        if f.first_bit % 8 == 0 and f.bits in (16, 24, 32, 64) and f.bytes_needed <= 8
    }
    channels = tuple(c.model_copy(update=found.get(c.channel, {})) for c in table.channel)
    eds = None if len(found) == len(fields) else table.eds
    return rig.model_copy(update={"can": table.model_copy(update={"channel": channels, "eds": eds})})


ENCODER_PROFILE = 406
ABSOLUTE_TYPES = (2, 8)
"""CiA 406, device type (1000h), upper half: multiturn absolute rotary and absolute linear encoders."""
BOOT_S = 0.3
"""Time that nodes have to answer a scan."""


@dataclass(frozen=True)
class Device:
    """Identity of an encoder by its own objects; None where it has no such object."""

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
        """Return the device's identity by name, for the recording's manifest."""
        names = [n for n in self.__dataclass_fields__ if n != "field"]
        known = {n: getattr(self, n) for n in names if getattr(self, n) is not None}
        return known | {"cob_id": self.field.identifier, "bits": self.field.bits}


class _Node(Objects):
    """The objects of a node on the bus."""

    def __init__(self, network: Any, number: int, channel: str) -> None:
        import canopen

        self.name = message("bus.node", node=number, channel=channel)
        self._sdo = network.add_node(canopen.RemoteNode(number, canopen.ObjectDictionary())).sdo  # type: ignore[no-untyped-call]

    def read(self, index: int, subindex: int = 0) -> int | None:
        """The object's value; AcquisitionError when the node does not answer."""
        from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

        try:
            return int.from_bytes(self._sdo.upload(index, subindex), "little")
        except SdoAbortedError:
            return None
        except SdoCommunicationError as error:
            raise AcquisitionError(message("error.no_answer_to_h", where=self.name, index=index, subindex=subindex, error=error)) from error


def start_nodes(bus: "can.BusABC", rig: Rig, passage: int = 1, folder: Path = Path()) -> tuple[Device, ...]:
    """Find, check and start the encoders of the rig's CiA 406 table over an open bus; return the devices in the cables' order.

    folder: the folder of the table's EDS file. AcquisitionError names the node, its channel and the disagreement with the rig.
    """
    from lmeasure.acquisition.bus.python_can import can, user

    canopen = user("canopen")
    table = rig.can_table
    if not isinstance(table, CanOpenCan):
        raise AcquisitionError(message("error.rig_its_decoder_is", name=rig.name, decoder=table.decoder))
    channels = {c.channel: c for c in table.channel}
    drums = rig.counters_of(passage)
    network = canopen.Network(bus)
    network.notifier = can.Notifier(bus, network.listeners, timeout=0.05)
    try:
        present = scan(network)
        missing = [channels[name] for name in drums if channels[name].node not in present]
        if missing:
            found = message("bus.no_node")
            if present:
                found = message("bus.nodes", nodes=", ".join(map(str, present)))
            raise AcquisitionError(message("error.node_channel_does_not", node=missing[0].node, channel=missing[0].channel, found=found))
        devices = tuple(_device(network, channels[name], drum, table) for name, drum in drums.items())
        _check_serials(devices, channels)
        if table.eds is not None:
            for d in devices:
                name = message("bus.node", node=d.node, channel=d.channel)
                check_identity(folder / table.eds, name, d.node, vendor=d.vendor, product=d.product)
        for device in devices:
            network.send_message(0, bytes([1, device.node]))  # NMT: start
        return devices
    finally:
        network.notifier.stop(timeout=1.0)
        network.bus = None  # it stays open


def scan(network: Any) -> list[int]:
    """Return the nodes that answer a read of their device type, or send anything else."""
    network.scanner.reset()
    network.scanner.search()
    time.sleep(BOOT_S)
    return sorted(network.scanner.nodes)


def _device(network: Any, wanted: NodeChannel, drum: Drum | SensorTable, table: CanOpenCan) -> Device:
    node = _Node(network, wanted.node, wanted.channel)
    device_type = node.need(0x1000)
    if device_type & 0xFFFF != ENCODER_PROFILE:
        raise AcquisitionError(
            message("error.its_device_profile_is", where=node.name, device_type=device_type & 65535, encoder_profile=ENCODER_PROFILE)
        )
    units, total = node.read(0x6001), node.read(0x6002)
    want = drum.scale * drum.counts_per_revolution
    if units is not None and wanted.scale * units != want:
        raise AcquisitionError(message("error.counts_per_revolution_6001h", where=node.name, scale=wanted.scale * units, want=want))
    if total and wanted.range and total != wanted.range:
        raise AcquisitionError(message("error.its_range_is_units", where=node.name, total=total, range=wanted.range))
    sync_id = node.read(0x1005)
    if table.timing == "sync" and sync_id is not None and sync_id & ALL_BITS != table.sync_id:
        raise AcquisitionError(message("error.listens_to_sync_1005h", where=node.name, sync_id=sync_id & ALL_BITS, sync_id2=table.sync_id))
    place = position_place(node, table.timing, node.read(0x6200))
    if wanted.cob_id is not None and (wanted.cob_id, 8 * wanted.byte_offset, wanted.bits) != (place[0], *place[3:5]):
        stated = message("bus.stated_place", cob_id=wanted.cob_id, byte=wanted.byte_offset, bits=wanted.bits)
        raise AcquisitionError(
            message("error.sends_its_position_in", where=node.name, place=place[0], place2=place[3], place3=place[4], stated=stated)
        )
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
        found = message("error.node_channel_its_serial", node=device.node, channel=device.channel, serial=device.serial, want=want)
        swapped = [message("bus.swapped", node=other.node, channel=other.channel)] if other else []
        raise AcquisitionError(joined([found, *swapped]))


def produce_sync(bus: "can.BusABC", sync_id: int, period_s: float) -> Any:
    """Send SYNC with that period from now on, by the interface if it can, else from a thread. Return a task with `stop()`.

    AcquisitionError when the interface does not give its own frames back: then counts could not be assigned to a SYNC.
    """
    from lmeasure.acquisition.bus.python_can import can

    sync = can.Message(arbitration_id=sync_id, is_extended_id=sync_id > 0x7FF)
    bus.send(sync)
    end = time.monotonic() + 1.0
    while (left := end - time.monotonic()) > 0:
        got = bus.recv(left)
        if got is not None and got.arbitration_id == sync_id:
            return bus.send_periodic(sync, period_s)
    raise AcquisitionError(message("error.the_interface_does_not"))
