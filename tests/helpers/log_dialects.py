"""Logs as programs of others write them: TRC of PEAK, candump's screen, SavvyCAN's table."""

from datetime import UTC, datetime, timedelta

import can
from log_corpus import START

from lmeasure.acquisition.logs.report import FD_LENGTHS

DAY_ZERO = datetime(1899, 12, 30, tzinfo=UTC)
START_TIME = (datetime.fromtimestamp(START, UTC) - DAY_ZERO) / timedelta(days=1)
TYPES = {(False, False): "FD", (True, False): "FB", (False, True): "FE", (True, True): "BI"}


def trc(log: list[can.Message], version: str, columns: str = "") -> str:
    """The log as PEAK's programs write it. Versions before 2.0 hold classic frames only."""
    lines = [f";$FILEVERSION={version}", f";$STARTTIME={START_TIME!r}"] if version != "1.0" else []
    lines += [f";$COLUMNS={columns}"] * bool(columns) + [";   a comment", ";---+--   ----+----  --+--  ----+---  +  -+ --"]
    for number, m in enumerate(log, 1):
        code = FD_LENGTHS.index(len(m.data)) if m.is_fd else m.dlc
        cell = {
            "N": f"{number}" + ")" * (version < "2"),
            "O": f"{(m.timestamp - START) * 1000:.3f}",
            "T": TYPES[m.bitrate_switch, m.error_state_indicator] if m.is_fd else "RR" if m.is_remote_frame else "DT",
            "B": str(int(str(m.channel)) + 1),
            "I": f"{m.arbitration_id:08X}" if m.is_extended_id else f"{m.arbitration_id:04X}",
            "d": "Rx" if m.is_rx else "Tx",
            "R": "-",
            "L": str(code),
            "l": str(len(m.data) if m.is_fd else m.dlc),
            "D": ("RTR" if version < "2" else "") if m.is_remote_frame else " ".join(f"{byte:02X}" for byte in m.data),
        }
        order = {"1.0": "N,O,I,L,D", "1.1": "N,O,d,I,L,D", "1.2": "N,O,B,d,I,L,D", "1.3": "N,O,B,d,I,R,L,D"}.get(version, columns)
        lines.append("  ".join(cell[name] for name in order.split(",")))
    return "\r\n".join(lines) + "\r\n"


def screen(log: list[can.Message], way: str = "a", extra: bool = False, text: bool = False, swapped: bool = False) -> str:
    """The log as `candump -t way` shows it; with -x, -a and -S."""
    lines, before = [], log[0].timestamp
    for m in log:
        stamp = {
            "a": f"{m.timestamp:017.6f}", "z": f"{m.timestamp - log[0].timestamp:010.6f}", "d": f"{m.timestamp - before:010.6f}",
            "A": datetime.fromtimestamp(m.timestamp).strftime("%Y-%m-%d %H:%M:%S.%f"), "": "",
        }[way]  # fmt: skip
        before = m.timestamp
        flags = f"{'RX' if m.is_rx else 'TX'} {'B' if m.bitrate_switch else '-'} {'E' if m.error_state_indicator else '-'}  " * extra
        identifier = f"{m.arbitration_id:08X}" if m.is_extended_id else f"{m.arbitration_id:03X}"
        data = "`".join(f"{b:02X}" for b in m.data[::-1]) if swapped else " ".join(f"{b:02X}" for b in m.data)
        shown = f"   '{''.join(chr(b) if 32 <= b < 127 else '.' for b in m.data)}'" * (text and not m.is_remote_frame)
        length = f"[{m.dlc:02d}]" if m.is_fd and not m.is_remote_frame else f"[{m.dlc}] "
        body = " remote request" if m.is_remote_frame else f" {data}{shown}"
        lines.append(f" ({stamp})" * bool(stamp) + f"  can{m.channel}  {flags}{identifier}  {length}{body}")
    return "\n".join(lines) + "\n"


def gvret(log: list[can.Message], *, direction: bool = True) -> str:
    lines = ["Time Stamp,ID,Extended," + "Dir," * direction + "Bus,LEN," + ",".join(f"D{i}" for i in range(1, 9))]
    for m in log:
        cells = [str(round((m.timestamp - START) * 1e6)), f"{m.arbitration_id:08X}", str(m.is_extended_id).lower()]
        cells += ["Rx" if m.is_rx else "Tx"] * direction
        cells += [str(m.channel), str(len(m.data)), *(f"{b:02X}" for b in m.data)]
        lines.append(",".join(cells) + "," * (8 - len(m.data) if len(m.data) < 8 else 1))
    return "\n".join(lines) + "\n"
