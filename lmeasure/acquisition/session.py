"""A recording session: rig, bus and devices brought together, as `lmeasure record` does it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lmeasure.acquisition.bus.canopen import Device, as_mapped, produce_sync, start_nodes
from lmeasure.acquisition.bus.frames import no_frames
from lmeasure.acquisition.bus.sources import Source, open_source
from lmeasure.acquisition.counters.assembly import new_assembler
from lmeasure.acquisition.counters.decoders import CounterField, counter_fields
from lmeasure.acquisition.counters.origins import range_notes
from lmeasure.acquisition.counters.samples import Samples
from lmeasure.acquisition.logs.import_log import fields_of_log, with_files_beside
from lmeasure.acquisition.recorder import Progress, Recording, record
from lmeasure.core import AcquisitionError
from lmeasure.io import files
from lmeasure.recording import start_from_text
from lmeasure.rig import CanOpenCan, Rig, read_linked_rig
from lmeasure.text import message

if TYPE_CHECKING:
    import can


def record_session(
    rig_path: Path,
    bus: str,
    folder: Path,
    *,
    seconds: float | None = None,
    start: str | None = None,
    passage: int = 1,
    options: Sequence[str] = (),
    paced: bool = True,
    show: Callable[[Progress], None] | None = None,
    each: Callable[[Samples], None] | None = None,
    stop: Callable[[], bool] = lambda: False,
    say: Callable[[str], None] = lambda text: None,
) -> Recording:
    """Open the bus for the rig's `[can]` table and record a pass; see `recorder.record`.

    start: as in `recording.run.stated_start`; options: KEY=VALUE for the interface. AcquisitionError in one line.
    """
    rig, calibration = read_linked_rig(rig_path)
    if passage > rig.passes:
        raise AcquisitionError(message("error.its_cables_need_pass", where=rig_path, passes=rig.passes, passage=passage))
    pose = None if start is None else start_from_text(start, rig)
    here = Path(rig_path).parent
    link = connect(rig, here, bus, passage=passage, options=options_from_text(options), paced=paced)
    try:
        for note in range_notes(rig, link.fields, passage):
            say(note)
        devices = [d.identity() for d in link.devices]
        kept, beside = with_files_beside(as_mapped(rig, link.fields), here)
        if calibration is not None and rig.calibration is not None:
            kept = kept.model_copy(update={"calibration": Path(rig.calibration).name})
            beside[Path(rig.calibration).name] = files.read_bytes(here / rig.calibration)
        return record(
            kept,
            link.source,
            link.fields,
            folder,
            start=pose,
            passage=passage,
            seconds=seconds,
            devices=devices,
            beside=beside,
            show=show,
            each=each,
            stop=stop,
        )
    finally:
        link.source.close()


@dataclass(frozen=True)
class Link:
    """An open source, the fields of its frames that are counters, and the CiA 406 devices behind them."""

    source: Source
    fields: tuple[CounterField, ...]
    devices: tuple[Device, ...] = ()


def connect(
    rig: Rig, folder: Path, bus: str, *, passage: int = 1, options: Mapping[str, str | int] | None = None, paced: bool = True
) -> Link:
    """Open the bus for the rig's `[can]` table: CiA 406 encoders are found, checked and started, again after each loss of the bus.

    folder: the folder of the table's DBC file. AcquisitionError in one line.
    """
    table = rig.can_table
    interface, _, channel = bus.partition(":")
    if not isinstance(table, CanOpenCan) or interface == "replay":
        fields = fields_of_log(rig, passage, folder, Path(channel)) if interface == "replay" else counter_fields(rig, passage, folder)
        _warm_up(rig, fields, passage)
        return Link(open_source(bus, table.bit_rate, options, paced=paced), fields)
    if interface == "simulated":
        raise AcquisitionError(message("error.bus_the_rig_s", bus=bus))
    given = dict(options or {})
    if table.sync_period_ms is not None and interface != "udp_multicast":  # which gives them back anyway
        given.setdefault("receive_own_messages", 1)
    devices: list[tuple[Device, ...]] = []

    def prepare(opened: "can.BusABC") -> None:
        found = start_nodes(opened, rig, passage, folder)
        for first, now in zip(devices[0] if devices else (), found, strict=False):
            if (now.serial, now.field) != (first.serial, first.field):
                other = message("bus.other_device", serial=now.serial, before=first.serial)
                raise AcquisitionError(message("error.node_channel", node=now.node, channel=now.channel, other=other))
        devices.append(found)
        if table.sync_period_ms is not None:
            produce_sync(opened, table.sync_id, table.sync_period_ms / 1e3)

    source = open_source(bus, table.bit_rate, given, paced=paced, prepare=prepare)
    fields = tuple(d.field for d in devices[0])
    _warm_up(rig, fields, passage)
    return Link(source, fields, devices[0])


def _warm_up(rig: Rig, fields: tuple[CounterField, ...], passage: int) -> None:
    """Compile the decoders of frames before any frame can be lost: it can take seconds the first time."""
    new_assembler(rig, fields, passage).feed(no_frames())


def options_from_text(options: Sequence[str]) -> dict[str, str]:
    """KEY=VALUE texts as a dictionary."""
    for option in options:
        if "=" not in option:
            raise AcquisitionError(message("error.bus_option_is_not", option=option))
    return dict(option.split("=", 1) for option in options)
