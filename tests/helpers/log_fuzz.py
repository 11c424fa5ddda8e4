"""Mutated logs, DBC files and rig files: each is read, or refused in one line; every line and object of a log is accounted for; and the
frames of a log are those that python-can reads."""

import contextlib
import io
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import numpy as np
from log_corpus import Row, library_rows, messages, rows, write
from log_dialects import gvret, screen, trc

from lmeasure.acquisition import counter_fields, import_logs, read_frames
from lmeasure.acquisition.bus.frames import messages_from_frames
from lmeasure.core import LMeasureError
from lmeasure.io import files
from lmeasure.rig import Rig, read_rig, rig_from_dict, write_rig

START_POSE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
SPECIAL = (0, 1, 0x7F, 0x80, 0xFF, 10, 13, 32, 9, 0x23, 0x28, 0x2E, 0x30, 0x78)
WORDS = (0, 1, 15, 16, 31, 2**31 - 1, 2**31, 2**32 - 1, 2**32 - 16)

DBC = (Path(__file__).parent / "six-counters.dbc").read_text(encoding="utf-8")


def six_cables(table: dict[str, object] | None = None) -> Rig:
    """A rig of six cables; by default with the encoders' own default frames."""
    drum = {
        "counts_per_revolution": 6000, "count_length_mm": 0.012, "groove_pitch_mm": 1.0, "tangent_length_mm": 180.0,
        "axial_offset_mm": 25.0,
    }  # fmt: skip
    points = [
        {
            "name": f"B{i}", "position_mm": [500.0 * (i % 3), -1500.0 + 300.0 * i, 1400.0], "guide_alpha_deg": 47.0,
            "guide_beta_deg": 30.0 * i, "pulley_radius_mm": 20.0, "drum": drum if table else {**drum, "counter_bits": 32},
        }
        for i in range(1, 7)
    ]  # fmt: skip
    cables = [{"name": f"c{i}", "channel": f"ch{i}", "from": f"B{i}", "to": f"P{i % 3}"} for i in range(1, 7)]
    tool = {"P0": [14.0, -14.0, 5.0], "P1": [-20.0, 3.0, 5.0], "P2": [3.0, 20.0, -5.0]}
    data: dict[str, object] = {"schema": "lmeasure.rig/1", "name": "six", "observation_point": points, "tool": tool, "cable": cables}
    return rig_from_dict(data | ({"can": table} if table else {}))


def dbc_table(path: Path) -> dict[str, object]:
    """A `[can]` table whose channels are the plain signals of `DBC`, six times over."""
    names = [1, 2, 3, 4, 5, 1]
    channels = [{"channel": f"ch{i + 1}", "message": f"Count{n}", "signal": f"ch{n}"} for i, n in enumerate(names)]
    return {"decoder": "dbc", "dbc": str(path), "channel": channels}


def counter_log(samples: int, seed: int) -> list[can.Message]:
    """SYNC and six counters at 1 kHz, among other traffic."""
    rng = np.random.default_rng(seed)
    others = iter(messages(samples, seed, channels=(0,)))
    counts = np.cumsum(rng.integers(-40, 41, (samples, 6)), axis=0)
    log = []
    for i in range(samples):
        t = 1_700_000_000 + i * 1e-3
        log.append(can.Message(timestamp=t, arbitration_id=0x80, is_extended_id=False, channel=0))
        for j in range(6):
            data = int(counts[i, j]).to_bytes(4, "little", signed=True)
            log.append(can.Message(timestamp=t + (j + 1) * 1e-4, arbitration_id=0x181 + j, is_extended_id=False, channel=0, data=data))
        other = next(others)
        other.timestamp = t + 8e-4
        log.append(other)
    return log


def seeds(folder: Path) -> dict[str, bytes]:
    """Whole files to mutate, by kind."""
    log = counter_log(12, 1)
    made = {suffix: write(folder / f"whole{suffix}", log).read_bytes() for suffix in (".asc", ".log", ".blf", ".csv")}
    classic = [m for m in log if not (m.is_error_frame or m.is_fd)]
    made[".trc"] = write(folder / "whole.trc", classic).read_bytes()
    plain = [m for m in log if not m.is_error_frame]
    made["2.trc"] = trc(plain, "2.1", "N,O,T,B,I,d,R,l,D").encode()
    made["gvret.csv"] = gvret([m for m in plain if not m.is_remote_frame]).encode()
    made[".txt"] = screen(plain).encode()
    made["canoe.asc"] = CANOE.encode()
    made["stored.blf"] = write(folder / "stored.blf", log, compression_level=0).read_bytes()
    made["small.blf"] = write(folder / "small.blf", log, max_container_size=300).read_bytes()
    made[".dbc"] = DBC.encode()
    write_rig(folder / "rig.toml", six_cables())
    made[".toml"] = (folder / "rig.toml").read_bytes()
    return made


CANOE = (
    """date Mon Nov 13 10:13:20.000 pm 2023
base hex  timestamps relative
internal events logged
// version 11.0.0
Begin TriggerBlock Mon Nov 13 10:13:20.000 pm 2023
   0.000000 Start of measurement
"""
    + "".join(
        f"""  0.001000 1  80              Rx   d 0  Length = 0 BitCount = 0 ID = 128
  0.000100 1  Encoder_1       Rx   d 4 {i:02X} 00 00 00  Length = 140000 BitCount = 73 ID = 385
 -0.000050 1  18FF0110x       Tx   d 8 10 11 12 13 14 15 16 {i:02X}  Length = 0 BitCount = 0 ID = 419365136x
  0.000100 CANFD   1 Rx        184  Counter_Message                 1 0 9 12 01 02 03 04 05 06 07 08 09 10 11 {i:02X}   0 0 3000 0 0 0 0 0
  0.000100 1  Statistic: D 12 R 0 XD 0 XR 0 E 0 O 0 B 1.20%
  0.000100 SV: 2 0 1 ::sys::x = {i}
"""
        for i in range(12)
    )
    + "End TriggerBlock\n"
)
JUNK = ("something else", "# a comment", "// a comment", "; a comment", "", "\t ", "1 2 3", "(", "-", "\x00\x00", "Ünknown", "0.1 1 2 3")


def mutated_lines(seed: bytes, rng: np.random.Generator) -> bytes:
    """Some changes of whole lines and words, as other recorders, editors and locales make them."""
    lines = seed.splitlines(keepends=True)
    for _ in range(int(rng.choice([1, 1, 2, 4]))):
        at = int(rng.integers(len(lines)))
        body = lines[at].rstrip(b"\r\n")
        end = lines[at][len(body) :]
        words = body.split(b" ")
        word = int(rng.integers(len(words)))
        match int(rng.integers(12)):
            case 0:
                lines[at] = b""
            case 1:
                lines[at] = lines[at] * 2
            case 2:
                lines[at] = JUNK[int(rng.integers(len(JUNK)))].encode() + end
            case 3:
                lines[at] = body[: int(rng.integers(len(body) + 1))] + end
            case 4:
                lines[at] = body.replace(b".", b",", 1) + end
            case 5:
                lines[at] = bytes(rng.choice([b"-", b"+", b" ", b"#", b"\xc2\xa0", b"x"])) + body + end
            case 6:
                words[word] = bytes(rng.choice([b"", b"?", b"Rx", b"-1", b"FFFFFFFFF", b"d", b"12,5"]))
                lines[at] = b" ".join(words) + end
            case 7:
                lines[at] = body + bytes(rng.choice([b" junk", b" 00", b"\t", b"x", b" // note"])) + end
            case 8:
                lines[at] = body.replace(b" ", b"\t") + end
            case 9:
                lines[at] = body.swapcase() + end
            case 10:
                lines[at] = body + bytes(rng.choice([b"\n", b"\r", b"\r\n", b"\n\r"]))
            case _:
                lines[at : at + 2] = lines[at : at + 2][::-1]
    return b"".join(lines)


def unaccounted(path: Path) -> str:
    """How the report of a log contradicts the file itself; empty where every line or object is accounted for, or the log is refused."""
    try:
        frames, report = read_frames(path)
    except LMeasureError:
        return ""
    if report.frames != len(frames) or report.frames + report.known + report.unread != report.total:
        return f"{report.frames} + {report.known} + {report.unread} are not {report.total}"
    if report.unread and not report.notes():
        return "unread, but not said"
    there = _objects(path.read_bytes()) if path.suffix == ".blf" else len(path.read_bytes().splitlines())
    if there is not None and there != report.total and not report.ended_early and not report.remarks:
        return f"{there} {report.unit}, {report.total} in the report"
    return ""


def _objects(raw: bytes) -> int | None:
    """Objects of a BLF file but containers, by a walk of our own; None where it contradicts itself."""
    stream, count, at = b"", 0, struct.unpack_from("<L", raw, 4)[0]
    while at + 32 <= len(raw):
        size, kind = struct.unpack_from("<LL", raw, at + 8)
        if raw[at : at + 4] != b"LOBJ" or size < 16:
            return None
        body = raw[at + 32 : at + size]
        if kind != 10:
            count += 1
        elif struct.unpack_from("<H", raw, at + 16)[0] == 2:
            try:
                stream += zlib.decompress(body)
            except zlib.error:
                return None
        else:
            stream += body
        at += size + size % 4
    at = 0
    while at + 16 <= len(stream):
        at = stream.find(b"LOBJ", at, at + 8)
        if at < 0:
            return None
        count += 1
        at += max(struct.unpack_from("<L", stream, at + 8)[0], 16)
    return count


def mutated(seed: bytes, rng: np.random.Generator) -> bytes:
    """A few random changes: bytes, words of extreme value, digits, cuts, repetitions, exchanged pieces."""
    data = bytearray(seed)
    for _ in range(int(rng.choice([1, 1, 1, 2, 3, 8]))):
        if not data:
            break
        at = int(rng.integers(len(data)))
        span = int(rng.integers(1, 40))
        match int(rng.integers(9)):
            case 0:
                data[at] ^= 1 << int(rng.integers(8))
            case 1:
                data[at] = int(rng.choice(SPECIAL))
            case 2:
                data[at : at + 4] = int(rng.choice(WORDS)).to_bytes(4, "little")
            case 3:
                del data[at : at + span]
            case 4:
                data[at:at] = rng.bytes(span)
            case 5:
                data[at:at] = data[at : at + span]
            case 6:
                digits = [i for i in range(at, min(at + 200, len(data))) if 48 <= data[i] <= 57]
                if digits:
                    data[int(rng.choice(digits))] = int(rng.choice(list(b"0123456789.-xeE")))
            case 7:
                del data[at:]
            case _:
                other = int(rng.integers(len(data)))
                data[at : at + span], data[other : other + span] = data[other : other + span], data[at : at + span]
    return bytes(data)


def use(path: Path, kind: str, rig: Rig) -> str:
    """Read the file as the program would: 'accepted' or 'refused'; AssertionError where neither."""
    try:
        if kind == ".dbc":
            counter_fields(six_cables(dbc_table(path)))
        elif kind == ".toml":
            read_rig(path)
        elif kind == "canoe.asc":  # has one counter only
            read_frames(path)
        else:
            import_logs([path], rig, START_POSE)
    except LMeasureError as error:
        text = str(error)
        assert text, "refused without a word"
        assert "\n" not in text, f"more than one line: {text!r}"
        assert len(text) < 2000, f"a very long line: {text[:200]!r}"
        return "refused"
    return "accepted"


def agrees_with_the_library(path: Path) -> bool:
    """What is read of the log is what python-can reads, wherever it can be asked.

    Behind a container or object of a BLF file that cannot be trusted python-can may run forever; a text log is put to it line by line,
    because it stops at the first one that it cannot read.
    """
    try:
        frames, report = read_frames(path)
    except LMeasureError:
        return True
    if path.suffix not in (".blf", ".asc", ".log"):
        return True
    found = [r for r in rows(messages_from_frames(frames)) if path.suffix == ".asc" or r[0] >= 0.0]
    if path.suffix != ".blf":
        return _accounted(_plain(found, path), path)
    if report.ended_early and any(words in report.ended_early for words in ("contradicts itself", "unpacked", "packed by")):
        return True
    expected, whole = library_rows(path)
    if whole and not report.ended_early:
        return found == expected
    return all(mine == theirs for mine, theirs in zip(found, expected, strict=False))


def _accounted(found: list[tuple[object, ...]], path: Path) -> bool:
    """Whether the rows of the lines that python-can reads are there, in order; those that no recorder writes may be missing."""
    at = 0
    for row, needed in _line_rows(path):
        wanted = _plain([row], path)[0]
        # others are among them: named frames, negative times
        place = next((i for i in range(at, len(found) if needed else min(at + 1, len(found))) if found[i] == wanted), -1)
        if place >= 0:
            at = place + 1
        elif needed:
            return False
    return True


def _line_rows(path: Path) -> Iterator[tuple[Row, bool]]:
    """The row of each line that python-can reads, and whether its numbers are written as recorders do."""
    raw = path.read_bytes()
    lines = re.split(rb"\r\n|\r|\n", raw)[:-1]
    base = can.ASCReader(io.StringIO(raw.decode("latin-1")))
    with contextlib.suppress(ValueError):  # a base that is neither hex nor dec
        base._extract_header()
    base_name = base.base if base.base in ("hex", "dec") else "hex"
    for line in lines:
        try:
            text = line.decode("utf-8").strip()
        except UnicodeDecodeError:
            text = line.decode("latin-1").strip()
        if not text:
            continue
        try:
            if path.suffix == ".asc":
                if re.match(r"(begin|end)\s+triggerblock", text, re.IGNORECASE):
                    continue
                found = list(can.ASCReader(io.StringIO(f"base {base_name}\ninternal events logged\n{text}\n")))
            else:
                found = list(can.CanutilsLogReader(io.StringIO(text)))
        except (ValueError, IndexError, TypeError, OverflowError):
            continue
        if path.suffix == ".log" and int(text.split()[2].split("#")[0], 16) & 0x20000000:
            for message in found:
                message.is_error_frame = True
        for row in rows([m for m in found if _sound(m)]):
            yield row, _written(text, path.suffix)


def _written(text: str, suffix: str) -> bool:
    """Whether the numbers of a line are written as recorders do: Python also reads signs, exponents and underscores."""
    if suffix == ".asc":
        stated = re.search(r"\sID\s*=\s*(\d+)", text)
        return not re.search(r"\s[+-]|\d_|txrq", text, re.ASCII | re.IGNORECASE) and stated is None
    parts = text.split()
    if len(parts) not in (3, 4) or "#" not in parts[2]:
        return False
    identifier, data = parts[2].split("#", 1)
    digits = set("0123456789")
    hexadecimal = digits | set("abcdefABCDEF")
    return (
        (parts[0][0], parts[0][-1]) == ("(", ")")
        and set(parts[0][1:-1]) <= digits | {"."}
        and parts[0][1].isdigit()
        and len(identifier) <= 8
        and set(identifier) <= hexadecimal
        and set(data) <= hexadecimal | set("#rR")
    )


def _sound(m: can.Message) -> bool:
    if m.arbitration_id > 0x7FF and not m.is_extended_id:
        return False
    if not abs(m.timestamp) <= 1e11 or not 0 <= m.arbitration_id < 2**29 or len(m.data) > 64 or not 0 <= m.dlc < 256:
        return False
    return m.is_remote_frame or m.is_error_frame or len(m.data) == m.dlc or (len(m.data) == 8 < m.dlc and not m.is_fd)


def _plain(found: list[Row], path: Path) -> list[tuple[object, ...]]:
    """Without what the two state differently on purpose: the start of an ASC log's time, the fields of candump's error frames."""
    out: list[tuple[object, ...]] = []
    for r in found:
        row: tuple[object, ...] = r[1:] if path.suffix == ".asc" else r
        out.append((r[0], "error") if r[4] and path.suffix == ".log" else row)
    return out


def run(folder: Path, count: int, seed: int, done: Callable[[str, str], None], go_on: bool = False) -> None:
    """Mutate and use `count` files; `done` gets kind and outcome of each. Where one misbehaves it is kept, and it is AssertionError, or the
    outcome 'neither' when asked to go on."""
    rng = np.random.default_rng(seed)
    made = seeds(folder)
    kinds = list(made)
    rig = six_cables()
    for i in range(count):
        kind = kinds[i % len(kinds)]
        path = folder / f"mutated{Path('x' + kind).suffix if not kind.startswith('.') else kind}"
        whole_lines = kind.endswith((".asc", ".log", ".trc", ".csv", ".txt")) and rng.integers(2)
        path.write_bytes((mutated_lines if whole_lines else mutated)(made[kind], rng))
        try:
            outcome = use(path, kind, rig)
            if kind not in (".dbc", ".toml"):
                wrong = unaccounted(path)
                assert not wrong, f"silent: {wrong}"
            assert kind in (".dbc", ".toml") or agrees_with_the_library(path), "other frames than python-can reads"
        except Exception as error:
            kept = folder / f"failed-{seed}-{i}{path.suffix}"
            files.write_text(kept.with_suffix(".txt"), f"{kind}: {type(error).__name__}: {error}\n")
            kept.write_bytes(path.read_bytes())
            if not go_on:
                raise AssertionError(f"{kept}: {type(error).__name__}: {error}") from error
            outcome = "silent" if str(error).startswith("silent") else "neither"
        done(kind, outcome)
