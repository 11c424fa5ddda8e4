"""The `[can]` table of a rig: the buses and frames of the counters.

Without it the encoders have the default of a CiA 406 encoder: the n-th channel as a signed 32-bit little-endian number in bytes 0 to 3 of
the frame 180h + n, answering SYNC 80h.
"""

from collections import Counter
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from lmeasure.io import Name, Strict, of_key
from lmeasure.text import message

SYNC_ID = 0x80
FIRST_PDO = 0x180

Identifier = Annotated[int, Field(ge=0, lt=2**29)]


class CounterChannel(Strict):
    """Common keys of a counter on the bus."""

    channel: Name
    """Channel of the rig that this counter measures."""
    scale: Annotated[float, Field(gt=0, le=1e6)] = 1.0
    """Recorded counts per unit of the device."""
    range: Annotated[int, Field(ge=256, le=2**64)] | None = None
    """Units until the device's counter wraps around; default: the drum's `counter_bits`, or all values of its field."""
    start: int = 0
    """Value of the device at the start pose."""
    absolute: bool = False
    """true: the device keeps its count while switched off, as absolute multiturn encoders do."""


Node = Annotated[int, Field(ge=1, le=127)]


class RawChannel(CounterChannel):
    """Counter at a fixed position of a frame."""

    id: Identifier
    """CAN identifier of the frame."""
    extended: bool = False
    """true: the identifier has 29 bits."""
    byte_offset: Annotated[int, Field(ge=0, le=63)] = 0
    """First byte of the counter in the frame."""
    bits: Literal[16, 24, 32, 64] = 32
    """Width of the counter in bits."""
    signed: bool = True
    """true: the highest bit is the sign."""
    byte_order: Literal["little", "big"] = "little"
    """Order of the bytes: lowest (little) or highest (big) first."""
    node: Node | None = None
    """CANopen node that sends the frame; default: the lowest seven bits of an identifier from 181h to 57Fh."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not self.extended and self.id > 0x7FF:
            raise of_key("id", message("error.has_more_than_11", id=self.id))
        if self.byte_offset + self.bits // 8 > 64:
            raise of_key("byte_offset", message("error.bits_from_byte_do", bits=self.bits, byte_offset=self.byte_offset))
        return self


class DbcChannel(CounterChannel):
    """Counter as a signal of a DBC file."""

    message: str
    """Message of the DBC file."""
    signal: str
    """Signal of that message."""
    node: Node | None = None
    """CANopen node that sends the frame; default: the lowest seven bits of an identifier from 181h to 57Fh."""
    whole_range: bool = False
    """true: all values are counts, also those outside [min|max] or named invalid or error in the file."""


class NodeChannel(CounterChannel):
    """Position value of a CiA 406 encoder. In a log, `cob_id`, `byte_offset` and `bits` locate it."""

    node: Node
    """Node number of the encoder."""
    serial: Annotated[int, Field(ge=0, lt=2**32)] | None = None
    """Serial number of the encoder (object 1018h); any other encoder is refused."""
    cob_id: Identifier | None = None
    """Frame of the position value, for logs."""
    byte_offset: Annotated[int, Field(ge=0, le=7)] = 0
    """First byte of the position value in that frame."""
    bits: Literal[16, 24, 32, 64] = 32
    """Width of the position value in bits."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.byte_offset + self.bits // 8 > 8:
            raise of_key("byte_offset", message("error.bits_from_byte_do", bits=self.bits, byte_offset=self.byte_offset))
        return self


class J1939Channel(CounterChannel):
    """Counter in a J1939 parameter group of a draw-wire sensor."""

    pgn: Annotated[int, Field(ge=0, lt=2**18)]
    """Parameter group number."""
    source_address: Annotated[int, Field(ge=0, le=255)] | None = None
    """Address of the sender; default: any."""
    byte_offset: Annotated[int, Field(ge=0, le=7)] = 0
    """First byte of the counter in the frame."""
    bits: Literal[16, 24, 32, 64] = 32
    """Width of the counter in bits."""
    signed: bool = False
    """true: the highest bit is the sign."""
    byte_order: Literal["little", "big"] = "little"
    """Order of the bytes: lowest (little) or highest (big) first."""
    whole_range: bool = False
    """true: all values are counts, also those with a highest byte from FBh, which J1939 reserves for errors."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.byte_offset + self.bits // 8 > 8:
            raise of_key("byte_offset", message("error.bits_from_byte_do", bits=self.bits, byte_offset=self.byte_offset))
        return self


class StartInput(Strict):
    """Bit of a frame that rises when counting starts (thesis Rashoyan 2021, 5.4), recorded as the column `sync`."""

    id: Identifier
    """CAN identifier of the frame."""
    extended: bool = False
    """true: the identifier has 29 bits."""
    byte_offset: Annotated[int, Field(ge=0, le=63)] = 0
    """Byte of the bit in the frame."""
    bit: Annotated[int, Field(ge=0, le=7)] = 0
    """Number of the bit in that byte, 0 for the lowest."""


class _Bus(Strict):
    """Common keys of all decoders."""

    bit_rate: Annotated[int, Field(gt=0, le=20_000_000)] | None = None
    """Bit rate [bit/s], passed to the adapter."""
    timing: Literal["sync", "free"] = "sync"
    """sync: encoders latch their counts at the SYNC frame; free: each encoder sends by its own timer."""
    sync_id: Identifier = SYNC_ID
    """CAN identifier of the SYNC frame."""
    start_input: StartInput | None = None
    """Bit that rises when counting starts."""


class RawCan(_Bus):
    """Counters at fixed positions of frames."""

    decoder: Literal["raw"] = "raw"
    """Decoder: counters at fixed positions of frames."""
    channel: Annotated[tuple[RawChannel, ...], Field(min_length=1)]
    """Counters, one table `[[can.channel]]` each."""


class DbcCan(_Bus):
    """Counters described by a DBC file."""

    decoder: Literal["dbc"]
    """Decoder: counters described by a DBC file."""
    dbc: Annotated[str, Field(min_length=1)]
    """DBC file; path relative to the rig file."""
    channel: Annotated[tuple[DbcChannel, ...], Field(min_length=1)]
    """Counters, one table `[[can.channel]]` each."""


class CanOpenCan(_Bus):
    """CiA 406 encoders. lmeasure reads the frame of their position value over SDO."""

    decoder: Literal["cia406"]
    """Decoder: CiA 406 encoders, read over SDO."""
    eds: Annotated[str, Field(min_length=1)] | None = None
    """Electronic data sheet; path relative to the rig file. Devices must match it, and logs are decoded by it."""
    sync_period_ms: Annotated[float, Field(ge=0.5, le=10_000)] | None = None
    """Period of the SYNC frames that lmeasure sends; default: another device sends them."""
    channel: Annotated[tuple[NodeChannel, ...], Field(min_length=1)]
    """Counters, one table `[[can.channel]]` each."""


class J1939Can(_Bus):
    """Draw-wire sensors that send J1939 parameter groups by their own timers."""

    decoder: Literal["j1939"]
    """Decoder: draw-wire sensors that send J1939 parameter groups."""
    timing: Literal["sync", "free"] = "free"
    """free: each sensor sends by its own timer; sync: at the SYNC frame."""
    channel: Annotated[tuple[J1939Channel, ...], Field(min_length=1)]
    """Counters, one table `[[can.channel]]` each."""


CanTable = Annotated[RawCan | DbcCan | CanOpenCan | J1939Can, Field(discriminator="decoder")]


def default_can(channels: tuple[str, ...]) -> RawCan:
    """The table of a rig without one: the default frames of CiA 406 encoders on nodes 1, 2, ..."""
    return RawCan(channel=tuple(RawChannel(channel=name, id=FIRST_PDO + i) for i, name in enumerate(channels, 1)))


def check_channels(table: RawCan | DbcCan | CanOpenCan | J1939Can, wanted: set[str]) -> None:
    """Raise ValueError if a channel occurs twice in the table, or one that a cable needs is missing."""
    for name, times in Counter(c.channel for c in table.channel).items():
        if times > 1:
            raise of_key("can", message("error.channel_is_given_times", name=name, times=times))
    missing = sorted(wanted - {c.channel for c in table.channel})
    if missing:
        raise of_key("can", message("error.channel_of_the_rig", missing=missing[0]))
