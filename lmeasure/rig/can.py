"""The `[can]` table of a rig: which frames of which bus carry the counters.

Absent, the encoders are taken to send what a CiA 406 encoder sends by default: the n-th channel as a signed 32-bit little-endian
number in bytes 0 to 3 of the frame 180h + n, answering SYNC 80h.
"""

from collections import Counter
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from lmeasure.io import Name, Strict

SYNC_ID = 0x80
FIRST_PDO = 0x180

Identifier = Annotated[int, Field(ge=0, lt=2**29)]


class CounterChannel(Strict):
    """What every decoder needs to know of one counter."""

    channel: Name
    """Channel of the cables that this counter serves."""
    scale: Annotated[float, Field(gt=0, le=1e6)] = 1.0
    """Recorded counts per unit of the device."""
    range: Annotated[int, Field(ge=256, le=2**64)] | None = None
    """How many units the device counts before it starts again; default the drum's counter_bits, or all values of its field."""
    start: int = 0
    """What the device shows at the start pose."""
    absolute: bool = False
    """Whether the device still knows its count after it was switched off, as absolute multiturn encoders do."""


Node = Annotated[int, Field(ge=1, le=127)]


class RawChannel(CounterChannel):
    """A counter at a fixed place of a frame."""

    id: Identifier
    """Identifier of the frame."""
    extended: bool = False
    """Whether the identifier has 29 bits."""
    byte_offset: Annotated[int, Field(ge=0, le=63)] = 0
    """First byte of the counter in the frame."""
    bits: Literal[16, 24, 32, 64] = 32
    """Width of the counter."""
    signed: bool = True
    """Whether its highest bit is a sign."""
    byte_order: Literal["little", "big"] = "little"
    """Which byte comes first."""
    node: Node | None = None
    """Number of the CANopen node that sends it; default the identifier's lowest seven bits, from 181h to 57Fh."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not self.extended and self.id > 0x7FF:
            raise ValueError(f"id: {self.id:#x} has more than 11 bits; say extended = true")
        if self.byte_offset + self.bits // 8 > 64:
            raise ValueError(f"byte_offset: {self.bits} bits from byte {self.byte_offset} do not fit a frame")
        return self


class DbcChannel(CounterChannel):
    """A counter as a signal of a DBC file."""

    message: str
    """Message of the DBC file."""
    signal: str
    """Signal in that message."""
    node: Node | None = None
    """Number of the CANopen node that sends it; default the identifier's lowest seven bits, from 181h to 57Fh."""
    whole_range: bool = False
    """Whether all values are counts, those outside [min|max] of the DBC file and those named invalid or error in it too."""


class NodeChannel(CounterChannel):
    """A counter that is the position value of a CiA 406 encoder; serial, when given, must be what the device says (1018h).

    cob_id, byte_offset and bits say which frame holds it where nobody can be asked, in a log; a recording states them in its own rig.
    """

    node: Node
    """Node number of the encoder."""
    serial: Annotated[int, Field(ge=0, lt=2**32)] | None = None
    """Its serial number (1018h); another one is refused."""
    cob_id: Identifier | None = None
    """Frame that holds the position in a log, where nobody can be asked."""
    byte_offset: Annotated[int, Field(ge=0, le=7)] = 0
    """First byte of the position in that frame."""
    bits: Literal[16, 24, 32, 64] = 32
    """Width of the position in that frame."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.byte_offset + self.bits // 8 > 8:
            raise ValueError(f"byte_offset: {self.bits} bits from byte {self.byte_offset} do not fit a frame")
        return self


class J1939Channel(CounterChannel):
    """A counter in a J1939 parameter group of a draw-wire sensor; source_address absent: any sender."""

    pgn: Annotated[int, Field(ge=0, lt=2**18)]
    """Parameter group number."""
    source_address: Annotated[int, Field(ge=0, le=255)] | None = None
    """Address of the sender; absent: any."""
    byte_offset: Annotated[int, Field(ge=0, le=7)] = 0
    """First byte of the counter."""
    bits: Literal[16, 24, 32, 64] = 32
    """Width of the counter."""
    signed: bool = False
    """Whether its highest bit is a sign."""
    byte_order: Literal["little", "big"] = "little"
    """Which byte comes first."""
    whole_range: bool = False
    """Whether all values are counts, those with a highest byte from FBh on too, which J1939 reserves for errors and `not available`."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.byte_offset + self.bits // 8 > 8:
            raise ValueError(f"byte_offset: {self.bits} bits from byte {self.byte_offset} do not fit a frame")
        return self


class StartInput(Strict):
    """One bit of a frame that rises when counting starts (thesis Rashoyan 2021, 5.4); it becomes the column `sync`."""

    id: Identifier
    """Identifier of the frame."""
    extended: bool = False
    """Whether the identifier has 29 bits."""
    byte_offset: Annotated[int, Field(ge=0, le=63)] = 0
    """Byte of the bit."""
    bit: Annotated[int, Field(ge=0, le=7)] = 0
    """The bit, 0 the lowest."""


class _Bus(Strict):
    """What every decoder needs to know of the bus."""

    bit_rate: Annotated[int, Field(gt=0, le=20_000_000)] | None = None
    """Bits per second, handed to the adapter."""
    timing: Literal["sync", "free"] = "sync"
    """sync: every encoder latches its count at the SYNC frame and then sends it; free: each sends by its own timer."""
    sync_id: Identifier = SYNC_ID
    """Identifier of the SYNC frame."""
    start_input: StartInput | None = None
    """A bit that rises when counting starts."""


class RawCan(_Bus):
    """Counters at fixed places of frames."""

    decoder: Literal["raw"] = "raw"
    """Counters at fixed places of frames."""
    channel: Annotated[tuple[RawChannel, ...], Field(min_length=1)]
    """The counters, a table `[[can.channel]]` each."""


class DbcCan(_Bus):
    """Counters named by a DBC file, a path beside the rig file."""

    decoder: Literal["dbc"]
    """Counters named by a DBC file."""
    dbc: Annotated[str, Field(min_length=1)]
    """The DBC file, beside the rig file."""
    channel: Annotated[tuple[DbcChannel, ...], Field(min_length=1)]
    """The counters, a table `[[can.channel]]` each."""


class CanOpenCan(_Bus):
    """CiA 406 encoders, asked over SDO where they put their position.

    sync_period_ms: this program produces the SYNC itself with that period; absent, somebody else does. eds: the devices' electronic data
    sheet, a path beside the rig file; they must be what it describes, and in a log their frames are mapped as it says.
    """

    decoder: Literal["cia406"]
    """CiA 406 encoders that are asked where they put their position."""
    eds: Annotated[str, Field(min_length=1)] | None = None
    """Their electronic data sheet, beside the rig file."""
    sync_period_ms: Annotated[float, Field(ge=0.5, le=10_000)] | None = None
    """Period of the SYNC that this program sends; absent: a device sends it."""
    channel: Annotated[tuple[NodeChannel, ...], Field(min_length=1)]
    """The counters, a table `[[can.channel]]` each."""


class J1939Can(_Bus):
    """Draw-wire sensors that send parameter groups by their own timers."""

    decoder: Literal["j1939"]
    """Draw-wire sensors that send parameter groups."""
    timing: Literal["sync", "free"] = "free"
    """As above; they send by their own timers."""
    channel: Annotated[tuple[J1939Channel, ...], Field(min_length=1)]
    """The counters, a table `[[can.channel]]` each."""


CanTable = Annotated[RawCan | DbcCan | CanOpenCan | J1939Can, Field(discriminator="decoder")]


def default_can(channels: tuple[str, ...]) -> RawCan:
    """The table of a rig without one: the default frames of CiA 406 encoders on nodes 1, 2, ..."""
    return RawCan(channel=tuple(RawChannel(channel=name, id=FIRST_PDO + i) for i, name in enumerate(channels, 1)))


def check_channels(table: RawCan | DbcCan | CanOpenCan | J1939Can, wanted: set[str]) -> None:
    """ValueError when a channel stands twice in the table, or one that a cable needs is missing."""
    for name, times in Counter(c.channel for c in table.channel).items():
        if times > 1:
            raise ValueError(f"can: channel {name!r} is given {times} times")
    missing = sorted(wanted - {c.channel for c in table.channel})
    if missing:
        raise ValueError(f"can: channel {missing[0]!r} of the rig is missing")
