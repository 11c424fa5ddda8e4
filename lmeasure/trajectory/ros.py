"""A trajectory as ROS 2 messages in an MCAP file: geometry_msgs/PoseWithCovarianceStamped, metres and radians (REP 103)."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmeasure import files
from lmeasure.arrays import IntArray
from lmeasure.errors import TrajectoryError
from lmeasure.extras import how_to_install
from lmeasure.trajectory.record import Trajectory

TOPIC = "/lmeasure/pose"
FRAME = "base"

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
    """Write a trajectory in pieces as messages on `TOPIC`, whole or not at all; metadata `lmeasure` keeps what the uncertainties cover.

    TrajectoryError when the package mcap is not installed, or a time lies before 0, which no stamp can tell.
    """
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise TrajectoryError(f"{path}: MCAP needs the package mcap: {how_to_install('ros')}") from error
    with files.whole(path) as temporary, temporary.open("wb") as out:
        writer = Writer(out)
        writer.start(profile="ros2", library="lmeasure")
        schema = writer.register_schema(name=SCHEMA, encoding="ros2msg", data=DEFINITION.encode())
        channel = writer.register_channel(topic=TOPIC, message_encoding="cdr", schema_id=schema)
        writer.add_metadata("lmeasure", {"uncertainty_covers": covers})

        def write(piece: Trajectory) -> None:
            times, packed = messages(piece)
            if len(times) and times[0] < 0:
                raise TrajectoryError(f"{path}: time_s = {float(piece.time_s[0])!r} lies before 0, which no time stamp of ROS can tell")
            for time, message in zip(times.tolist(), packed, strict=True):
                writer.add_message(channel_id=channel, log_time=time, publish_time=time, data=message.tobytes())

        yield write
        writer.finish()  # type: ignore[no-untyped-call]
