"""python-can's udp_multicast, held to its own group.

python-can 4.6 binds its sockets to every address: a socket then gets whatever any socket of this machine has joined on that port, and
what is sent to the machine itself. Two recordings on two groups would hear each other.
"""

import contextlib
import socket
import struct
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import can


def bind_to_group(bus: "can.BusABC") -> None:
    """Exchange the bus's socket for one that is bound to its group; where the system cannot (Windows), it stays as it is."""
    link: Any = getattr(bus, "_multicast", None)
    old = getattr(link, "_socket", None)
    if not isinstance(old, socket.socket):
        return
    own = socket.socket(old.family, socket.SOCK_DGRAM)
    try:
        own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "SO_REUSEPORT"):
            own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        if link.timestamp_nanosecond:
            from can.interfaces.udp_multicast.bus import SO_TIMESTAMPNS

            own.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        own.bind((link.group, link.port))
        group = socket.inet_pton(old.family, link.group)
        if old.family == socket.AF_INET:
            own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, struct.pack("@I", link.hop_limit))
            own.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group + struct.pack("@I", socket.INADDR_ANY))
        else:
            own.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, struct.pack("@I", link.hop_limit))
            own.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, group + struct.pack("@I", 0))
    except OSError:
        own.close()
        return
    link._socket = own
    with contextlib.suppress(OSError):
        old.close()


def is_garbled(error: Exception) -> bool:
    """Whether the bus is whole and only the datagram was no frame: anybody may send anything to a group."""
    return "could not unpack received message" in str(error)
