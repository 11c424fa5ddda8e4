"""BLF files object by object, as python-can's writer does not write them."""

import struct
import zlib


def blf(objects: bytes, stated: int = 0, outside: bytes = b"", *, packed: bool = True, before: bool = False) -> bytes:
    """Return a BLF file of one container, and objects outside; its header states `stated` objects."""
    body = zlib.compress(objects) if packed else objects
    container = b"LOBJ" + struct.pack("<HHLL", 16, 1, 32 + len(body), 10) + struct.pack("<H6xL4x", 2 if packed else 0, len(objects)) + body
    container += bytes((32 + len(body)) % 4)
    content = (outside + container if before else container + outside) if objects else outside
    head = struct.pack("<4sLBBBBBBBBQQLL", b"LOGG", 144, 5, 0, 0, 0, 2, 6, 8, 1, 144 + len(content), 0, stated, 0)
    return head.ljust(144, b"\0") + content


def blf_object(kind: int, body: bytes, version: int = 1, time: int = 10**9, *, flags: int = 2, size: int | None = None) -> bytes:
    """Return an object with a header of version 1, 2 or 3 (3: static size where 1 has the client index)."""
    head = struct.pack("<LBxHQ8x", flags, 0, 0, time) if version == 2 else struct.pack("<LHHQ", flags, len(body) * (version == 3), 0, time)
    stated = 16 + len(head) + len(body) if size is None else size
    return b"LOBJ" + struct.pack("<HHLL", 16 + len(head), version, stated, kind) + head + body + bytes(stated % 4 if size is None else 0)


def can_message(identifier: int = 0x181, data: bytes = b"\1\2\3\4", dlc: int | None = None, flags: int = 0, channel: int = 1) -> bytes:
    """Return the body of an object CAN_MESSAGE."""
    return struct.pack("<HBBL8s", channel, flags, len(data) if dlc is None else dlc, identifier, data)
