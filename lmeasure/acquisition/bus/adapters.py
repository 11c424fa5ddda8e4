"""CAN adapters of this machine that can be found without opening them, and the senders on a bus.

Run as a program, it prints the channels of python-can's drivers, one line of JSON per interface: a driver that hangs does not stop others.
"""

import contextlib
import json
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from typing import Any

LEFT_OUT = ("virtual", "udp_multicast", "serial", "socketcand")
"""Interfaces that lead only to other programs, always exist, or do not speak CAN. Users name the daemons that they start themselves."""
PATIENCE_S = 4.0


@dataclass(frozen=True)
class Adapter:
    """Bus in the notation of `--bus`, its options in that of `--bus-option`, and a description."""

    bus: str
    options: tuple[str, ...] = ()
    about: str = ""

    def line(self) -> str:
        more = "".join(f" --bus-option {one}" for one in self.options)
        return f"{self.bus}{more}" + (f"  ({self.about})" if self.about else "")


def adapters(patience_s: float = PATIENCE_S) -> tuple[tuple[Adapter, ...], tuple[str, ...]]:
    """Adapters, and interfaces whose driver did not answer in time."""
    process = subprocess.Popen([sys.executable, "-m", __name__], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    lines: list[str] = []
    assert process.stdout is not None
    reader = threading.Thread(target=lines.extend, args=(process.stdout,), daemon=True)
    reader.start()
    reader.join(patience_s)
    process.kill()
    reader.join(1.0)
    process.wait()
    requested: set[str] = set()
    found: list[Adapter] = []
    for line in list(lines):
        with contextlib.suppress(ValueError):
            reported = json.loads(line)
            if "asks" in reported:
                requested.add(reported["asks"])
                continue
            requested.discard(reported["interface"])
            found += [one for config in reported["configs"] if (one := _adapter(config)) is not None]
    found += [Adapter(f"slcan:{port}", (), about) for port, about in _serial_ports()]
    unique = {(one.bus, one.options): one for one in found}
    return tuple(unique.values()), tuple(sorted(requested))


def _adapter(config: dict[str, Any]) -> Adapter | None:
    """Return the adapter of python-can's keywords; values that are not plain are objects of the driver, and no part of its name."""
    interface, channel = config.get("interface"), config.get("channel")
    if not interface or channel is None or interface in LEFT_OUT:
        return None
    plain = {k: v for k, v in config.items() if k not in ("interface", "channel") and isinstance(v, str | int) and not isinstance(v, bool)}
    options = tuple(f"{k}={v}" for k, v in plain.items() if k not in ("device_name", "vector_channel_config"))
    return Adapter(f"{interface}:{channel}", options, str(plain.get("device_name", "")))


def _serial_ports() -> list[tuple[str, str]]:
    """Serial ports of USB, on which an adapter may speak SLCAN."""
    try:
        from serial.tools.list_ports import comports  # type: ignore[import-untyped]
    except ImportError:
        return []
    return [(p.device, " ".join(str(p.description or "").split())) for p in comports() if p.vid is not None]


def _ask_all() -> None:
    """Each driver in a thread of its own."""
    from lmeasure.acquisition.bus.python_can import can

    lock = threading.Lock()

    def tell(**values: Any) -> None:
        with lock:
            print(json.dumps(values, default=str), flush=True)

    def ask(interface: str) -> None:
        configs: list[Any] = []
        with contextlib.suppress(Exception):  # a driver that is not installed raises whatever it likes
            configs = [dict(one) for one in can.detect_available_configs([interface], timeout=2 * PATIENCE_S)]
        tell(interface=interface, configs=configs)

    threads = []
    for interface in sorted(set(can.interfaces.BACKENDS) - set(LEFT_OUT)):
        tell(asks=interface)
        threads.append(threading.Thread(target=ask, args=(interface,), daemon=True))
        threads[-1].start()
    end = time.monotonic() + 2 * PATIENCE_S
    for thread in threads:
        thread.join(max(end - time.monotonic(), 0.0))


if __name__ == "__main__":
    import logging

    logging.disable(logging.CRITICAL)
    _ask_all()
