"""Every reader of files from outside with a small right file, and attempts to do harm by each; for tests and for fuzzing."""

import copy
import io
import json
import math
import re
import resource
import signal
import struct
import time
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import can
import h5py
import hostile
import log_fuzz
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import tomli_w

from lmeasure.accuracy import read_bodies, read_placement, read_zone
from lmeasure.acquisition import read_frames
from lmeasure.certificate import opened_zip, read_certificate, read_dcc, read_details, read_private_key, read_public_key
from lmeasure.core import LMeasureError
from lmeasure.io.files import read_table, read_toml
from lmeasure.recording import read_counts, read_poses, read_program, read_run
from lmeasure.rig import read_calibration_record, read_drums, read_linked_rig, read_rig
from lmeasure.robot_programs import dialect_of, opened
from lmeasure.robots import Robot, read_map, read_measurements, read_robot, read_urdf, write_urdf
from lmeasure.sensors import lengths_from_counts
from lmeasure.simulation import read_scenario
from lmeasure.structure import read_linkage
from lmeasure.trajectory import read_trajectory, write_trajectory
from lmeasure.workflows import init

HERE = Path(__file__).parents[1]
SECRET = "nobody's business 4711"
REPEATED = 200_000
"""Letters of a word that is repeated."""
LONGEST_S = 5.0
"""Processor time that any attempt may take."""
POSES = b"pose,x_mm,y_mm,z_mm,qx,qy,qz,qw\n1,0,0,0,0,0,0,1\n2,100,0,0,0,0,0,1\n3,0,100,0,0,0,0,1\n"
COUNTS = b"time_s,ch1,ch2,ch3,ch4,ch5,ch6\n0,0,0,0,0,0,0\n0.001,5,7,1,2,3,4\n0.002,9,,1,2,3,5\n"
MOTION = b"time_s,x_mm,y_mm,z_mm,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n0.1,1,0,0,0,0,0,1\n0.2,2,0,0,0,0,0,1\n"
JOINTS = b"joint_1_deg,joint_2_deg,joint_3_deg,joint_4_deg,joint_5_deg,joint_6_deg"
ROWS = b"name," + JOINTS + b",x_mm,y_mm,z_mm\na,0,0,0,0,0,0,1,2,3\nb,1,2,3,4,5,6,7,8,9\n"
BODIES = b'schema = "lmeasure.bodies/1"\n[[body]]\nname = "a"\ncentre_mm = [0, 0, 0]\nradius_mm = 10.0\n'
RECORD = {
    "rig": "demo", "parameters": [{"name": "B1.x_mm", "value": 1.0, "u": 0.1, "prior_u": 3}], "covariance": [[0.01]],
    "residuals": [], "equations": 3, "unknowns": 1, "rank": 1,
}  # fmt: skip
PROGRAMS = {
    ".ls": b"/PROG A\n/MN\n   1:L P[1] 100mm/sec FINE ;\n/POS\nP[1]{\n   GP1:\n    UF : 0, UT : 0, CONFIG : 'N U T, 0, 0, 0',\n"
    b"    X = 500.000 mm, Y = 0.000 mm, Z = 600.000 mm,\n    W = 180.000 deg, P = 0.000 deg, R = 0.000 deg\n};\n/END\n",
    ".src": b"DEF A()\nLIN {X 500,Y 0,Z 600,A 0,B 90,C 0}\nEND\n",
    ".mod": b"MODULE A\nCONST robtarget p1:=[[500,0,600],[0,0,1,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];\n"
    b"PROC main()\nMoveL p1,v100,fine,tool0;\nENDPROC\nENDMODULE\n",
    ".script": b"def a():\n  movel(p[0.5,0.0,0.6,0.0,3.14,0.0], a=1.2, v=0.1)\nend\n",
}
XML_HEAD = '<?xml version="1.0"?>\n'


@dataclass(frozen=True)
class Reader:
    """A reader: the suffix of its file, a right file, and how it is read. kind: what is tried with it."""

    name: str
    suffix: str
    right: bytes
    read: Callable[[Path], Any]
    kind: str


def _run_of(name: str) -> Callable[[Path], Any]:
    def read(path: Path) -> Any:
        run = HERE / "authorities" / "truth" / "cell-run"
        for other in ("rig.toml", "run.toml", "pass1.csv"):
            if other != name:
                (path.parent / other).write_bytes((run / other).read_bytes() if other != "pass1.csv" else COUNTS)
        path.replace(path.with_name(name))
        return lengths_from_counts(read_run(path.parent))

    return read


def _scenario(path: Path) -> Any:
    (path.parent / "rig.toml").write_bytes((HERE / "authorities" / "truth" / "cell-run" / "rig.toml").read_bytes())
    return read_scenario(path)


def _program(path: Path) -> Any:
    sources = opened([path])
    return dialect_of([path], sources).read(sources)


def _ur5() -> Robot:
    robot = read_robot(HERE.parent / "lmeasure" / "robots" / "shipped" / "ur5.toml")
    assert isinstance(robot, Robot)
    return robot


@cache
def readers() -> dict[str, Reader]:
    """Return all readers by name."""
    truth = HERE / "authorities" / "truth"
    found: list[Reader] = []

    def add(name: str, suffix: str, right: bytes, read: Callable[[Path], Any], kind: str) -> None:
        found.append(Reader(name, suffix, right, read, kind))

    with TemporaryDirectory() as scratch:
        cell = Path(scratch) / "cell"
        init.run_init(init.InitSettings(out=cell, template="six-cables"))
        for name, read in (("scenario", _scenario), ("placement", read_placement), ("drums", read_drums), ("program", read_program)):
            if (cell / f"{name}.toml").exists():
                add(name, ".toml", (cell / f"{name}.toml").read_bytes(), read, "toml")
        write_urdf(Path(scratch) / "r.urdf", _ur5())
        add("urdf", ".urdf", (Path(scratch) / "r.urdf").read_bytes(), read_urdf, "xml")
        seeds = log_fuzz.seeds(Path(scratch))
        for suffix in (".asc", ".log", ".blf", ".csv", ".trc", ".txt"):
            add(f"log {suffix[1:]}", suffix, seeds[suffix], read_frames, "log")
        mcap, mf4, motion = (Path(scratch) / name for name in ("t.mcap", "t.mf4", "t.csv"))
        motion.write_bytes(MOTION)
        write_trajectory(mcap, read_trajectory(motion))
        add("mcap", ".mcap", mcap.read_bytes(), read_trajectory, "binary")
        with can.MF4Writer(mf4) as log:
            log.on_message_received(can.Message(timestamp=1.7e9, arbitration_id=0x181, data=b"1234", is_extended_id=False))
        add("mf4", ".mf4", mf4.read_bytes(), read_frames, "binary")
        zone = Path(scratch) / "zone.nc"
        with h5py.File(zone, "w") as file:
            for axis in "xyz":
                file.create_dataset(axis, data=np.arange(3.0))
            file.create_dataset("in_zone", data=np.ones((3, 3, 3), np.int8))
            file.create_dataset("worst_pressure_angle_deg", data=np.ones((3, 3, 3)))
        add("zone", ".nc", zone.read_bytes(), read_zone, "hdf5")
    run = truth / "cell-run"
    inputs = HERE / "authorities" / "sealed" / "with-run"
    shipped = HERE.parent / "lmeasure" / "robots" / "shipped"
    add("rig", ".toml", (run / "rig.toml").read_bytes(), read_linked_rig, "toml")
    add("swivel rig", ".toml", (truth / "swivel-run" / "rig.toml").read_bytes(), read_rig, "toml")
    add("linkage", ".toml", (run / "rig.toml").read_bytes(), read_linkage, "toml")
    add("run", ".toml", (run / "run.toml").read_bytes(), _run_of("run.toml"), "toml")
    add("details", ".toml", (inputs / "inputs" / "details.toml").read_bytes(), read_details, "toml")
    add("tests", ".toml", (inputs / "inputs" / "program.toml").read_bytes(), read_program, "toml")
    add("robot", ".toml", (shipped / "ur5.toml").read_bytes(), read_robot, "toml")
    add("platform", ".toml", (shipped / "rotopod.toml").read_bytes(), read_robot, "toml")
    add("bodies", ".toml", BODIES, read_bodies, "toml")
    add("any toml", ".toml", b"a = 1\n", read_toml, "toml")
    add("calibration", ".json", json.dumps(RECORD).encode(), read_calibration_record, "json")
    add("certificate", ".json", (inputs / "certificate.json").read_bytes(), read_certificate, "json")
    add("counts", ".csv", COUNTS, read_counts, "csv")
    add("pass", ".csv", COUNTS, _run_of("pass1.csv"), "csv")
    add("poses", ".csv", POSES, lambda path: read_poses(path, "puma-oat"), "csv")
    add("trajectory", ".csv", MOTION, read_trajectory, "csv")
    add("measurements", ".csv", ROWS, lambda path: read_measurements(path, _ur5().model), "csv")
    add("map", ".csv", b"x_mm,y_mm,z_mm,dx_mm,dy_mm,dz_mm\n0,0,0,1,1,1\n9,0,0,1,1,1\n", read_map, "csv")
    add("table", ".csv", MOTION, read_table, "csv")
    add("dcc", ".xml", f'{XML_HEAD}<dcc:digitalCalibrationCertificate xmlns:dcc="https://ptb.de/dcc"/>'.encode(), read_dcc, "xml")
    columns = pa.table({name: np.arange(3.0) for name in ("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")})
    held = io.BytesIO()
    pa.parquet.write_table(columns, held)
    add("parquet", ".parquet", held.getvalue(), read_trajectory, "binary")
    add("tum", ".tum", b"0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", read_trajectory, "binary")
    add("zip", ".zip", hostile.packed(hostile.GOOD), _unpacked, "zip")
    add("public key", ".pub", (HERE / "authorities" / "sealed" / "laboratory.pem.pub").read_bytes(), read_public_key, "binary")
    key = b"-----BEGIN PRIVATE KEY-----\nMC4CAQAwBQYDK2VwBCIEIA==\n-----END PRIVATE KEY-----\n"
    add("private key", ".pem", key, read_private_key, "binary")
    for suffix, text in PROGRAMS.items():
        add(f"program {suffix[1:]}", suffix, text, _program, "log")
    return {one.name: one for one in found}


def _unpacked(path: Path) -> None:
    with opened_zip(path, path.parent):
        pass


# --- attempts

NUMBERS: tuple[Any, ...] = (True, -1, 0, 2**63, 1e308, -1e308, 5e-324, math.nan, math.inf, "", "1", [], {}, [[]], None)
TEXTS: tuple[Any, ...] = (
    "", "../secret.txt", "/etc/passwd", "a\0b", "a\nb", "=1+1", "<script>alert(1)</script>", "x" * 100_000, "\u202e", "{0.__class__}",
    "%s%n", "${HOME}", "con", "\ufeff", 1, True, [], {}, None,
)  # fmt: skip
PARTS: tuple[Any, ...] = (True, 0, "", "x", [], {}, [1], [[[]]], ["a"] * 1000, [math.nan] * 3, [1e308] * 3, None)
CELLS = (
    "", "nan", "inf", "-inf", "1e999", "9" * 400, "0x10", "1_0", "١", "1,5", "=1+1", "@SUM(A1)", '"', '"a\nb"', "a\0", "true", "2020-01-01",
    "x" * 70_000, "-0", "+1", " 1 ", "\t", "1e-400", "\ufeff1", "\ud7ff",
)  # fmt: skip


def leaves(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Yield the place and value of each node of a document, of lists the first entry only."""
    if path:
        yield path, node
    for key, inner in node.items() if isinstance(node, dict) else list(enumerate(node))[:1] if isinstance(node, list) else ():
        yield from leaves(inner, (*path, key))


def altered(document: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the document with one value that does not belong there, for a third of all values in each place."""
    for number, (path, value) in enumerate(leaves(document)):
        kinds = PARTS if isinstance(value, dict | list) else TEXTS if isinstance(value, str) else NUMBERS
        for bad in kinds[number % 3 :: 3]:
            changed = copy.deepcopy(document)
            inside: Any = changed
            for key in path[:-1]:
                inside = inside[key]
            if bad is None:
                del inside[path[-1]]
            else:
                inside[path[-1]] = bad
            yield changed
    yield document | {"__class__": 1, "x" * 1000: {}}


def _texts(right: bytes) -> Iterator[bytes]:
    yield b""
    yield b"\0" * 100
    yield b"\xff\xfe" + right.decode("latin-1").encode("utf-16-le")
    yield right + b"\xff\xfe\xfd"
    yield right + b"\0"
    yield right.replace(b"\n", b"\r")
    yield right * 3
    yield b"\n" * 100_000
    yield b" " * 1_000_000
    yield right[: len(right) // 2]
    yield hostile.DIGITS.encode() * 20
    yield hostile.deep(100_000).encode()


def _toml(right: bytes) -> Iterator[bytes]:
    text = right.decode()
    for changed in altered(tomllib.loads(text)):
        try:
            yield tomli_w.dumps(changed).encode()
        except (TypeError, UnicodeEncodeError):
            continue
    deep = 100_000
    for extra in (
        f"a = {'[' * deep}{']' * deep}", f"a = {'{a=' * 2000}1{'}' * 2000}", ".".join(["a"] * deep) + " = 1", f"[{'.'.join(['a'] * 5000)}]",
        f"a = {hostile.DIGITS}", f"a = 1e{hostile.DIGITS}", f"a = 0x{'f' * 5000}", 'a = "\\ud800"', 'a = "\\u0000"', "a = 9999-99-99",
        f"a = [{'1,' * deep}]", "[[a]]\n" * 20_000, "a = 1\na = 2", f"a = {'9' * 4300}.0", "'" * deep, "a = '''" + "x" * deep,
    ):  # fmt: skip
        yield (text + "\n" + extra + "\n").encode()
        yield (extra + "\n" + text).encode()


def _json(right: bytes) -> Iterator[bytes]:
    document = json.loads(right)
    for changed in altered(document):
        yield json.dumps(changed).encode()
    text = right.decode().strip()
    for extra in (
        '"a": NaN', '"a": 1e999', f'"a": {hostile.DIGITS}', f'"a": {hostile.deep(100_000)}', '"a": "\\ud800"', '"a": 1, "a": 2',
        '"__proto__": {}', '"a": ' + '{"a":' * 50_000 + "1" + "}" * 50_000,
    ):  # fmt: skip
        yield f"{text[:-1]}, {extra}}}".encode()
    yield from (b"[]", b"null", b"1", b'"a"', b"NaN", b"{", b"[" * 100_000)


def _csv(right: bytes) -> Iterator[bytes]:
    head, *rows = right.decode().splitlines()
    names = head.split(",")
    for column in range(len(names)):
        for cell in CELLS[column % 2 :: 2]:
            cells = rows[0].split(",")
            cells[column] = cell
            yield "\n".join([head, ",".join(cells), *rows[1:], ""]).encode()
        for name in ("", names[0], names[column].upper(), "=1", "x" * 10_000, '"'):
            yield "\n".join([",".join([*names[:column], name, *names[column + 1 :]]), *rows, ""]).encode()
    yield "\n".join([head, *rows, rows[0] + ",1"]).encode()
    yield "\n".join([head, *rows, rows[0].rpartition(",")[0]]).encode()
    yield "\n".join([",".join(f"c{i}" for i in range(5000)), ",".join(["1"] * 5000)]).encode()
    yield (head + "\n" + (rows[0] + "\n") * 20_000).encode()
    yield right.replace(b",", b";")
    yield right.replace(b",", b"\t")
    yield b"sep=;\n" + right


def _xml(right: bytes) -> Iterator[bytes]:
    text = right.decode().removeprefix(XML_HEAD)
    text = text[text.index("?>") + 2 :] if text.startswith("<?xml") else text
    name = text.lstrip().lstrip("<").split()[0].split(">")[0].rstrip("/")
    bomb = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 12))
    kinds = {
        "laughs": f'<!DOCTYPE {name} [<!ENTITY e0 "ha">{bomb}]>', "quadratic": f'<!DOCTYPE {name} [<!ENTITY e11 "{"x" * 100_000}">]>',
        "file": f'<!DOCTYPE {name} [<!ENTITY e11 SYSTEM "SECRET">]>', "parameter": f'<!DOCTYPE {name} [<!ENTITY % p SYSTEM "SECRET"> %p;]>',
        "dtd": f'<!DOCTYPE {name} SYSTEM "SECRET">', "public": f'<!DOCTYPE {name} PUBLIC "a" "http://127.0.0.1:1/a.dtd">',
        "net": f'<!DOCTYPE {name} [<!ENTITY e11 SYSTEM "http://127.0.0.1:1/">]>', "none": f"<!DOCTYPE {name}>",
    }  # fmt: skip
    for kind, doctype in kinds.items():
        for inner in ("&e11;", "&e11;" * 1000 if kind in ("quadratic", "laughs") else "", ""):
            body = text.replace("/>", f">{inner}</{name}>", 1) if text.rstrip().endswith("/>") else text.replace("</", f"{inner}</", 1)
            yield f"{XML_HEAD}{doctype}{body}".encode()
    yield f'{XML_HEAD}<?xml-stylesheet href="SECRET"?>{text}'.encode()
    yield (
        text.replace(f"<{name}", f'<{name} xmlns:xi="http://www.w3.org/2001/XInclude"', 1)
        .replace("</", '<xi:include href="SECRET" parse="text"/></', 1)
        .encode()
    )
    yield (f"{XML_HEAD}" + "<a>" * 50_000 + "</a>" * 50_000).encode()
    yield text.replace(f"<{name}", f'<{name} a="{"x" * 1_000_000}"', 1).encode()
    yield text.replace(f"<{name}", f"<{name} " + " ".join(f'a{i}="1"' for i in range(20_000)), 1).encode()
    yield f'<?xml version="1.0" encoding="utf-7"?>{text}'.encode()
    yield f'<?xml version="1.1"?>{text}'.encode()
    yield text.encode("utf-16")
    for number, found in enumerate(re.finditer(r'"([^"]*)"', text)):
        if number < 60:
            for bad in CELLS[number % 5 :: 5]:
                yield (text[: found.start(1)] + bad.replace('"', "").replace("\0", "") + text[found.end(1) :]).encode()


def _repeated(right: bytes) -> Iterator[bytes]:
    """Yield each word and line of a right file many times over: a reader that looks on from every place never ends with them."""
    if b"\0" in right[:1000]:
        return
    words = dict.fromkeys(re.findall(r"\w+|\S", right[:3000].decode("latin-1")))
    for word in list(words)[:: max(len(words) // 20, 1)]:
        for unit in (word, f"{word} ", f"{word}\n", f"{word}("):
            yield (unit * (REPEATED // len(unit))).encode("latin-1")
        for filler in (" ", "\n", "9"):
            yield right + f"\n{word}{filler * REPEATED}{word}!".encode("latin-1")
    for line in dict.fromkeys(right.splitlines()[:30]):
        yield right + (line + b"\n") * (REPEATED // (len(line) + 1))
        yield right + line[:-1] * (REPEATED // (len(line) + 1))


def _bytes(right: bytes) -> Iterator[bytes]:
    rng = np.random.default_rng(len(right))
    for part in range(10):
        yield right[: len(right) * part // 10]
    for _ in range(20):
        out = bytearray(right)
        out[int(rng.integers(len(out)))] ^= 1 << int(rng.integers(8))
        yield bytes(out)
    for size in (4, 8):
        for value in (2**31 - 1, 2**32 - 1, 2**63 - 1 if size == 8 else 1):
            for at in rng.integers(0, max(len(right) - size, 1), 4).tolist():
                yield right[:at] + struct.pack("<Q", value)[:size] + right[at + size :]


def _lines(right: bytes) -> Iterator[bytes]:
    if b"\0" in right[:1000]:
        return
    lines = right.decode("latin-1").splitlines()
    for number in np.linspace(0, len(lines) - 1, 8).astype(int).tolist():
        for cell in CELLS[number % 4 :: 4]:
            words = lines[number].split(" ")
            words[number % len(words)] = cell
            yield "\n".join([*lines[:number], " ".join(words), *lines[number + 1 :]]).encode("utf-8", "replace")
    yield ("x" * 3_000_000).encode()


def _hdf5(right: bytes) -> Iterator[bytes]:
    def changed(change: Callable[[h5py.File], None]) -> bytes:
        held = io.BytesIO(right)
        with h5py.File(held, "r+") as file:
            change(file)
        return held.getvalue()

    def replaced(name: str, value: Any) -> Callable[[h5py.File], None]:
        def change(file: h5py.File) -> None:
            del file[name]
            file[name] = value

        return change

    def huge(file: h5py.File) -> None:
        del file["in_zone"]
        file.create_dataset("in_zone", shape=(10**6, 10**6, 10**4), chunks=(64, 64, 64), dtype="i1")

    def long_axis(file: h5py.File) -> None:
        del file["x"]
        file.create_dataset("x", shape=(10**11,), chunks=(1024,), dtype="f8")

    for name in ("x", "in_zone", "worst_pressure_angle_deg"):
        for link in (h5py.ExternalLink("SECRET", "/"), h5py.SoftLink("/none"), h5py.SoftLink(f"/{name}")):
            yield changed(replaced(name, link))
        arrays = (np.zeros(0), np.full(3, np.nan), np.full((3, 3, 3), np.inf), np.array([3.0, 2.0, 2.0]), np.arange(5))
        for value in ("text", b"x", 1.0, *arrays):
            yield changed(replaced(name, value))
    yield changed(huge)
    yield changed(long_axis)

    def outside(file: h5py.File) -> None:
        del file["x"]
        file.create_dataset("x", shape=(3,), dtype="f8", external=[("SECRET", 0, 24)])

    yield changed(outside)

    def deep(file: h5py.File) -> None:
        group: Any = file
        for _ in range(300):
            group = group.create_group("g")

    yield changed(deep)

    def attributes(file: h5py.File) -> None:
        file.attrs.update({"zone_volume_mm3": "x", "title": "x" * 60_000, "lmeasure": np.zeros(1000), "limit_deg": np.nan})

    yield changed(attributes)


def _zip(right: bytes) -> Iterator[bytes]:
    yield from hostile.zips().values()
    yield hostile.bomb(3 * 2**30)
    yield hostile.bomb(200 * 2**20, 5)
    yield hostile.packed(("a/" * 500 + "b", b""))
    yield hostile.packed(*((zipfile.ZipInfo(f"d{i}/"), b"") for i in range(100)))


KINDS: dict[str, tuple[Callable[[bytes], Iterator[bytes]], ...]] = {
    "toml": (_texts, _toml, _bytes), "json": (_texts, _json, _bytes), "csv": (_texts, _csv, _bytes), "xml": (_texts, _xml),
    "log": (_texts, _lines, _repeated, _bytes), "binary": (_texts, _bytes), "hdf5": (_bytes, _hdf5), "zip": (_bytes, _zip),
}  # fmt: skip


class TooLong(BaseException):
    """Ends an attempt, whatever the reader catches."""


def _too_long(*_: object) -> None:
    raise TooLong


def attempts(reader: Reader) -> Iterator[bytes]:
    """Yield the contents that are tried with a reader; SECRET in them is the path of a file that is nobody's business."""
    for make in KINDS[reader.kind]:
        yield from make(reader.right)


def judged(reader: Reader, content: bytes, folder: Path) -> str:
    """Read a content, and say what is wrong with how that ended; nothing where it was read, or refused in a line."""
    secret = folder / "secret.txt"
    secret.write_text(SECRET)
    inside = folder / "in"
    inside.mkdir(exist_ok=True)
    path = inside / f"file{reader.suffix}"
    path.write_bytes(content.replace(b"SECRET", str(secret).encode()) if reader.kind == "xml" else content)
    begun, memory = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    text = ""
    signal.signal(signal.SIGPROF, _too_long)
    signal.setitimer(signal.ITIMER_PROF, 2.0 * LONGEST_S)
    try:
        read = reader.read(path)
        if SECRET in repr(read)[:100_000]:
            return "shows what it should not"
    except LMeasureError as error:
        text = str(error)
        if "\n" in text or SECRET in text:
            return f"no line: {text[:200]!r}"
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:200]}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    took, grown = time.process_time() - begun, (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory) / 1024.0
    if took > LONGEST_S:
        return f"{took:.1f} s of processor"
    if grown > 700.0:
        return f"{grown:.0f} MB"
    if secret.read_text() != SECRET or {one.name for one in folder.iterdir()} != {"secret.txt", "in"}:
        return "writes outside"
    return ""
