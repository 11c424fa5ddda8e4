"""A trajectory as ROS 2 messages in an MCAP file: geometry_msgs/PoseWithCovarianceStamped, metres and radians (REP 103)."""

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmeasure.core import FileFormatError, FloatArray, IntArray, LMeasureError, TrajectoryError, how_to_install
from lmeasure.io import files, open_regular
from lmeasure.text import Message, message, reason
from lmeasure.trajectory.files.trajectory import Trajectory

TOPIC = "/lmeasure/pose"
FRAME = "base"
POSES = {"PoseStamped": 7, "PoseWithCovarianceStamped": 43}  # Messages that are read, and how many numbers follow their header

SCHEMA = "geometry_msgs/msg/PoseWithCovarianceStamped"
_PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
}
DEFINITION = "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose\n" + "".join(
    f"{'=' * 80}\nMSG: {name}\n{text}\n" for name, text in _PARTS.items()
)

# CDR, little-endian: the encapsulation's four bytes, then every value aligned to its size, counted from behind them
_MESSAGE = np.dtype(
    [
        ("encapsulation", "V4"),
        ("sec", "<i4"),
        ("nanosec", "<u4"),
        ("length", "<u4"),
        ("frame_id", f"S{len(FRAME) + 1}"),
        ("padding", f"V{-(12 + len(FRAME) + 1) % 8}"),
        ("pose", "<f8", 7),
        ("covariance", "<f8", (6, 6)),
    ]
)
_ORDER = np.array([3, 4, 5, 0, 1, 2])  # of (rotation; tool origin) in ROS, which has the position first


def messages(trajectory: Trajectory) -> tuple[IntArray, NDArray[Any]]:
    """(k,) times [ns] and (k,) messages of the poses that are known whole."""
    known = ~np.isnan(trajectory.poses).any(axis=1)
    nanoseconds = np.rint(trajectory.time_s[known] * 1e9).astype(np.int64)
    out = np.zeros(len(nanoseconds), _MESSAGE)
    out["encapsulation"] = np.void(b"\x00\x01\x00\x00")
    out["sec"], out["nanosec"] = nanoseconds // 10**9, nanoseconds % 10**9
    out["length"], out["frame_id"] = len(FRAME) + 1, FRAME.encode()
    out["pose"] = trajectory.poses[known] * np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0, 1.0])
    unit = np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0])
    both = (trajectory.random[known] + trajectory.systematic[known])[:, _ORDER][:, :, _ORDER]
    out["covariance"] = both * unit[:, None] * unit
    return nanoseconds, out


@contextmanager
def mcap_writer(path: Path, covers: str) -> Iterator[Callable[[Trajectory], None]]:
    """Write a trajectory in pieces as messages on `TOPIC`, whole or not at all; metadata `lmeasure` keeps the sources in the uncertainties.
    TrajectoryError if the package mcap is not installed, or a time is before 0, for which there is no stamp."""
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise TrajectoryError(message("error.mcap_needs_the_package", where=path, install=how_to_install("ros"))) from error
    with files.whole(path) as temporary, temporary.open("wb") as out:
        writer = Writer(out)
        writer.start(profile="ros2", library="lmeasure")
        schema = writer.register_schema(name=SCHEMA, encoding="ros2msg", data=DEFINITION.encode())
        channel = writer.register_channel(topic=TOPIC, message_encoding="cdr", schema_id=schema)
        writer.add_metadata("lmeasure", {"uncertainty_covers": covers})

        def write(piece: Trajectory) -> None:
            times, packed = messages(piece)
            if len(times) and times[0] < 0:
                raise TrajectoryError(message("error.time_s_lies_before", where=path, time_s=float(piece.time_s[0])))
            for time, one in zip(times.tolist(), packed, strict=True):
                writer.add_message(channel_id=channel, log_time=time, publish_time=time, data=one.tobytes())

        yield write
        writer.finish()  # type: ignore[no-untyped-call]


@dataclass(frozen=True)
class Messages:
    """Poses of a topic: time_s (n,), poses (n, 7) mm, covariance (n, 6, 6) of (rotation [rad]; position [mm]) or None of poses without."""

    time_s: FloatArray
    poses: FloatArray
    covariance: FloatArray | None


def read_messages(path: Path, topic: str | None = None) -> Messages:
    """The poses of an MCAP file, of ROS 1 or 2: PoseStamped or PoseWithCovarianceStamped, by the stamps in the messages. FileFormatError
    where the file is none, or where there are none or several such topics and none is named."""
    try:
        from mcap.reader import make_reader
    except ImportError as error:
        raise TrajectoryError(message("error.mcap_needs_the_package", where=path, install=how_to_install("ros"))) from error
    found: dict[str, list[tuple[float, FloatArray]]] = {}
    try:
        with open_regular(path) as file:
            for schema, channel, one in make_reader(file).iter_messages():
                kind = "" if schema is None else schema.name.rsplit("/", 1)[-1]
                if kind in POSES and channel.message_encoding in ("cdr", "ros1"):
                    found.setdefault(channel.topic, []).append(_pose_in(one.data, channel.message_encoding == "cdr", POSES[kind]))
    except LMeasureError:
        raise
    except Exception as error:  # whatever the reader and the unpackers make of a broken file
        raise FileFormatError(message("error.cannot_be_read_as_mcap", where=path, error=_why(error))) from None
    if topic is None and len(found) == 1:
        topic = next(iter(found))
    if topic not in found:
        have = ", ".join(sorted(found)) or "–"
        requested = message("trajectory_file.state_topic") if topic is None else message("trajectory_file.no_topic", topic=topic)
        raise FileFormatError(message("error.topics_with_posestamped_or", where=path, have=have, requested=requested))
    rows = sorted(found[topic], key=lambda each: each[0])
    values = np.array([row for _, row in rows])
    time_s, poses = np.array([t for t, _ in rows]), values[:, :7] * np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0, 1.0])
    if values.shape[1] == 7:
        return Messages(time_s, poses, None)
    unit = np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0])
    covariance = (values[:, 7:].reshape(-1, 6, 6) * unit[:, None] * unit)[:, _ORDER][:, :, _ORDER]
    return Messages(time_s, poses, covariance)


def _why(error: Exception) -> str:
    found = reason(error)
    return found if isinstance(found, Message) else " ".join(found.split())[:200]


def _pose_in(data: bytes, cdr: bool, numbers: int) -> tuple[float, FloatArray]:
    """Time [s] and the doubles of a message: in CDR values are aligned to their size from behind the first four bytes, in ROS 1 they are
    not, and a number of the message comes first."""
    order = "<" if not cdr or data[1] & 1 else ">"
    begin = 4
    seconds, part, length = struct.unpack_from(f"{order}iII", data, begin)
    at = begin + 12 + length
    if cdr:
        at += -(at - begin) % 8
    values = np.frombuffer(data, f"{order}f8", numbers, at).astype(np.float64)
    if not np.isfinite(values[:7]).all():
        raise ValueError(message("trajectory_file.not_finite"))
    return seconds + 1e-9 * part, values
