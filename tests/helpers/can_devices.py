"""Devices to talk to in the tests: CiA 406 encoders, a socketcand daemon, a slcan adapter. They know nothing of lmeasure."""

import contextlib
import os
import select
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from typing import Any

import can
import canopen
from canopen.objectdictionary import ObjectDictionary, ODArray, ODRecord, ODVariable, datatypes as types


def encoder_dictionary(node: int, settings: dict[str, int]) -> Any:
    """The objects of an encoder: TPDO1 by timer and TPDO2 at SYNC, both with the position after `lead` bits of something else."""
    od: Any = ObjectDictionary()  # type: ignore[no-untyped-call]

    def variable(index: int, name: str, kind: int, default: int, subindex: int = 0) -> Any:
        v: Any = ODVariable(name, index, subindex)
        v.data_type, v.access_type, v.default = kind, "rw", default
        return v

    od.add_object(variable(0x1000, "device type", types.UNSIGNED32, settings.get("device_type", 0x00020196)))
    od.add_object(variable(0x1001, "error register", types.UNSIGNED8, 0))
    od.add_object(variable(0x1005, "sync cob-id", types.UNSIGNED32, settings.get("sync_id", 0x80)))
    od.add_object(variable(0x1017, "heartbeat", types.UNSIGNED16, 0))
    identity: Any = ODRecord("identity", 0x1018)
    for sub, (name, value) in enumerate(
        [("entries", 4), ("vendor", 0x1234), ("product", 77), ("revision", 3), ("serial", settings.get("serial", 9000 + node))]
    ):
        identity.add_member(variable(0x1018, name, types.UNSIGNED8 if sub == 0 else types.UNSIGNED32, value, sub))
    od.add_object(identity)
    od.add_object(variable(0x6001, "units per revolution", types.UNSIGNED32, settings.get("units", 6000)))
    od.add_object(variable(0x6002, "total range", types.UNSIGNED32, settings.get("range", 0)))
    od.add_object(variable(0x6004, "position", types.UNSIGNED32, 0))
    od.add_object(variable(0x6200, "cyclic timer", types.UNSIGNED16, settings.get("timer_ms", 0)))
    od.add_object(variable(0x6500, "status", types.UNSIGNED16, 0))
    lead = settings.get("lead", 0)
    for number, kind in ((0, 254), (1, settings.get("sync_type", 1))):
        com: Any = ODRecord("com", 0x1800 + number)
        cob = (0x180 if number == 0 else 0x280) + node
        for sub, (name, size, value) in enumerate(
            [("n", types.UNSIGNED8, 2), ("cob", types.UNSIGNED32, cob), ("type", types.UNSIGNED8, kind)]
        ):
            com.add_member(variable(0x1800 + number, name, size, value, sub))
        od.add_object(com)
        mapping: Any = ODArray("map", 0x1A00 + number)
        entries = ([0x65000010] if lead else []) + [0x60040020]
        mapping.add_member(variable(0x1A00 + number, "n", types.UNSIGNED8, len(entries), 0))
        for sub, value in enumerate(entries, 1):
            mapping.add_member(variable(0x1A00 + number, f"entry {sub}", types.UNSIGNED32, value, sub))
        od.add_object(mapping)
    return od


class Encoders:
    """CiA 406 encoders on one bus that latch and send at SYNC once started, the k-th SYNC the k-th row of their positions."""

    def __init__(self, bus: can.BusABC, positions: Callable[[int, int], int], nodes: dict[int, dict[str, int]]) -> None:
        self._network: Any = canopen.Network(bus)
        self._network.NOTIFIER_CYCLE = 0.02
        self._network.connect()
        self._positions, self._settings = positions, nodes
        self.nodes = {n: self._network.create_node(n, encoder_dictionary(n, s)) for n, s in nodes.items()}
        for node in self.nodes.values():
            node.nmt.state = "PRE-OPERATIONAL"
        self.syncs = 0
        for cob in {s.get("sync_id", 0x80) for s in nodes.values()}:
            self._network.subscribe(cob, self._on_sync)

    def _on_sync(self, cob: int, data: bytearray, timestamp: float) -> None:
        started = [n for n, node in self.nodes.items() if node.nmt.state == "OPERATIONAL"]
        if not started:
            return
        for n in started:
            lead = b"\xab\xcd" if self._settings[n].get("lead") else b""
            span = self._settings[n].get("range", 0) or 2**32
            payload = lead + (self._positions(self.syncs, n) % span).to_bytes(4, "little")
            self._network.send_message(0x280 + n, payload)
        self.syncs += 1

    def produce_sync(self, count: int, period_s: float, cob: int = 0x80) -> None:
        """Be the SYNC producer too: count SYNCs, each followed by its answers before the next can be sent."""
        self._network.unsubscribe(cob)  # its own
        begin = time.perf_counter()
        for k in range(count):
            time.sleep(max(begin + k * period_s - time.perf_counter(), 0.0))
            self._network.send_message(cob, b"")
            self._on_sync(cob, bytearray(), 0.0)

    def started(self) -> bool:
        """Whether every node has been started."""
        return all(node.nmt.state == "OPERATIONAL" for node in self.nodes.values())

    def emergency(self, node: int, code: int) -> None:
        """Send an EMCY of a node."""
        self._network.send_message(0x80 + node, code.to_bytes(2, "little") + bytes([1, 0, 0, 0, 0, 0]))

    def close(self) -> None:
        """Stop, and close the bus."""
        self._network.disconnect()


class Socketcand:
    """A socketcand daemon on a loopback port that relays frames between its clients, as the kernel's CAN would: rawmode only."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._clients: list[socket.socket] = []
        self._lock = threading.Lock()
        self._threads = [threading.Thread(target=self._accept, daemon=True)]
        self._threads[0].start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._server.accept()
            except OSError:
                return
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            thread = threading.Thread(target=self._serve, args=(client,), daemon=True)
            self._threads.append(thread)
            thread.start()

    def _serve(self, client: socket.socket) -> None:
        client.sendall(b"< hi >")
        pending = b""
        with contextlib.suppress(OSError):
            while chunk := client.recv(65536):
                pending += chunk
                *commands, pending = pending.split(b">")
                relayed = []
                for command in commands:
                    words = command.replace(b"<", b" ").split()
                    if words[:1] == [b"open"]:
                        client.sendall(b"< ok >")
                    elif words[:1] == [b"rawmode"]:
                        with self._lock:
                            client.sendall(b"< ok >")
                            self._clients.append(client)
                    elif words[:1] == [b"send"]:
                        data = b"".join(w.rjust(2, b"0") for w in words[3:])
                        relayed.append(b"< frame %s %.6f %s >" % (words[1], time.time(), data))
                if relayed:
                    with self._lock:
                        for other in self._clients:
                            if other is not client:
                                other.sendall(b"".join(relayed))
        with self._lock:
            if client in self._clients:
                self._clients.remove(client)
        client.close()

    def close(self) -> None:
        """Drop everybody."""
        self._server.close()
        with self._lock:
            for client in self._clients:
                with contextlib.suppress(OSError):
                    client.shutdown(socket.SHUT_RDWR)
        for thread in self._threads[1:]:
            thread.join(5.0)


@contextlib.contextmanager
def slcan_adapter() -> Iterator[tuple[str, Callable[[bytes], None]]]:
    """A serial CAN adapter on a pty: the port's name, and a function that makes it say a frame line (such as b"t1812ABCD")."""
    ours, theirs = os.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    opened, done = threading.Event(), threading.Event()

    def answer() -> None:
        while not done.is_set():
            if not select.select([ours], [], [], 0.05)[0]:
                continue
            if b"O" in os.read(ours, 256):
                opened.set()

    thread = threading.Thread(target=answer, daemon=True)
    thread.start()

    def say(line: bytes) -> None:
        opened.wait(10.0)
        view = memoryview(line + b"\r")
        while view:
            view = view[os.write(ours, view) :]

    try:
        yield os.ttyname(theirs), say
    finally:
        done.set()
        thread.join()
        os.close(ours)
        os.close(theirs)
