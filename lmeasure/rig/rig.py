"""The rig: observation points, drums, attachment points and cables, exactly as rig.toml writes them."""

import difflib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, create_model, model_validator

from lmeasure import kernels
from lmeasure.core import DataFrame, FloatArray, IntArray, RigError, Shown, conventions, framed, plug_in_names
from lmeasure.io import Keys, Name, Strict, checked, files, of_key, refuse
from lmeasure.rig.can import CanOpenCan, CanTable, DbcCan, J1939Can, RawCan, check_channels, default_can
from lmeasure.rig.points_and_drums import (
    Cable as Cable,
    CableOnDrum,
    Drum as Drum,
    Expansion,
    Length,
    NotNegative,
    ObservationPoint as ObservationPoint,
)
from lmeasure.rig.sensor_table import TABLES, Distance, Inclination, SensorChannel, SensorTable, Swivel, fill_point, table_of
from lmeasure.rig.typical_sizes import TYPICAL_SIZES, Unstated
from lmeasure.text import message

CABLES_FOR_A_POSE = 6


def _one_line(value: str) -> str:
    if not value.isprintable():
        raise ValueError(message("error.must_be_one_line"))
    return value


Observed = Cable | SensorChannel
"""Owner of a channel of readings."""


@dataclass(frozen=True)
class _Zeroing:
    """Zeroing of counters: arguments of `Rig.zeroed_at`. Rigs are equal whatever it is."""

    poses: FloatArray | None = field(default=None, compare=False)
    counts: FloatArray | None = field(default=None, compare=False)
    cables: tuple[Observed, ...] = field(default=(), compare=False)


class Rig(Shown, Strict):
    """Instrument, the content of rig.toml: observation points, drums, attachment points, cables and other sensors.

    Examples
    --------
    >>> [cable.name for cable in rig.cable]
    ['c1', 'c2', 'c3', 'c4', 'c5', 'c6']
    """

    schema_: Annotated[Literal["lmeasure.rig/1"], Field(alias="schema")] = "lmeasure.rig/1"
    """Kind and version of the file."""
    name: Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_one_line)]
    """Name of the rig in reports."""
    angles: Annotated[str, Field(json_schema_extra={"enum": list(conventions.CONVENTIONS)})] = conventions.DEFAULT
    """Angle convention of the controller, for reference poses and start poses."""
    unstated: Unstated = "typical"
    """Meaning of a missing `u_...` key: typical, a typical size, which reports mark as assumed; exact, 0."""
    assumed: tuple[str, ...] = ()
    """Guessed values of this file, such as `B1.pulley_radius_mm` or `P1`: they get wide priors, and reports name them."""
    calibration: str | None = None
    """Calibration record beside this file, with the covariance of the parameters; `calibrate` writes it and this link."""
    constraint: Literal["planar", "vertical-axis"] | None = None
    """Constraint for rigs with fewer than six cables: z and tilts fixed (planar), or tilts fixed (vertical-axis)."""
    side: tuple[float, float, float] | None = None
    """Direction from the middle of the observation points to the tool, base frame; selects the assembly mode at the start."""
    frame_expansion_per_k: Expansion | None = None
    """Thermal expansion coefficient of the frame with observation points and drums, about the base frame's origin."""
    reference_temperature_c: Annotated[float, Field(ge=-100, le=200)] | None = None
    """Temperature at which the rig has the dimensions of this file; default: 20 °C (ISO 1)."""
    u_frame_expansion_per_k: NotNegative | None = None
    """Standard uncertainty of `frame_expansion_per_k`."""
    u_temperature_k: NotNegative | None = None
    """Standard uncertainty of the parts' temperature, relative to the thermometer."""
    u_attachment_mm: NotNegative | None = None
    """Standard uncertainty of each coordinate of every attachment point, tool frame."""
    observation_point: Annotated[tuple[ObservationPoint, ...], Field(min_length=1)]
    """Observation points, one table `[[observation_point]]` each."""
    tool: Annotated[dict[Name, tuple[Length, Length, Length]], Field(min_length=1)]
    """Attachment points by name, tool frame [mm]."""
    cable: Annotated[tuple[Cable, ...], Field(min_length=1)]
    """Cables, one table `[[cable]]` each."""
    swivel: tuple[Swivel, ...] = ()
    """Encoders on swivel pulleys, one table `[[swivel]]` each."""
    inclination: tuple[Inclination, ...] = ()
    """Axes of inclinometers on the tool, one table `[[inclination]]` each."""
    distance: tuple[Distance, ...] = ()
    """Straight distances, one table `[[distance]]` each."""
    can: CanTable | None = None
    """Frames of the bus that carry the counters; default: those of CiA 406 encoders on nodes 1, 2, ..."""

    @classmethod
    def further_keys(cls) -> tuple[str, ...]:
        """Return the tables of sensors that other packages add."""
        return plug_in_names(kernels.GROUP)

    def about(self) -> dict[str, str]:
        """Name, cables, points, calibration."""
        passes = f" in {self.passes} passes" if self.passes > 1 else ""
        assumed = {"assumed": ", ".join(self.assumed)} if self.assumed else {}
        linked = "none" if self.calibration is None else self.calibration
        points = ", ".join(p.name for p in self.observation_point)
        beside = {kind: ", ".join(e.channel for e in of) for kind, of in self.sensor_tables.items() if of}
        cables = f"{len(self.cable)}{passes}"
        return {"name": self.name, "cables": cables, "observation points": points, "calibration": linked} | beside | assumed

    def to_frame(self) -> DataFrame:
        """A row for each cable: its ends, its observation point, guide and pulley."""
        rows = []
        for cable in self.cable:
            point = self.point(cable.from_point)
            rows.append(
                {"cable": cable.name, "channel": cable.channel, "pass": cable.passage, "from": cable.from_point, "to": cable.to_point}
                | dict(zip(("x_mm", "y_mm", "z_mm"), point.position_mm, strict=True))
                | {name: getattr(point, name) for name in ("guide_alpha_deg", "guide_beta_deg", "pulley_radius_mm")}
                | {"count_length_mm": point.drum.count_length_mm}
            )
        return framed(rows)

    _paid_out: dict[str, float] = PrivateAttr(default_factory=dict)
    """True counts from `zero_length_mm` to where the counters were zeroed, by cable (`zeroed_at`)."""
    _zeroing: _Zeroing = PrivateAttr(default_factory=_Zeroing)
    """Zeroing of the counters (`zeroed_at`)."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        cables = [{"name": c.name, "channel": c.channel, "from": c.from_point, "to": c.to_point, "pass": c.passage} for c in self.cable]
        refuse(_references({"observation_point": [{"name": p.name} for p in self.observation_point], "tool": self.tool, "cable": cables}))
        if self.angles not in conventions.CONVENTIONS:
            raise of_key("angles", message("error.is_not_one_of_2", name=self.angles, templates=", ".join(conventions.CONVENTIONS)))
        passes = {c.passage for c in self.cable}
        if passes != set(range(1, len(passes) + 1)):
            raise of_key("cable", message("error.the_passes_are_they", passes=sorted(passes)))
        self._check_sensors()
        if self.can is not None:
            check_channels(self.can, {*self.channels, *(e.channel for e in self.sensors)})
        known = set(self.parameter_names())
        hints = {name: difflib.get_close_matches(name, known, n=1) for name in self.assumed if name not in known}
        refuse(
            (("assumed",), message("error.names_no_value", name=name, hint=message("complaint.did_you_mean", near=near[0]) if near else ""))
            for name, near in hints.items()
        )
        return self

    def _check_sensors(self) -> None:
        taken = Counter(self.all_channels)
        found: list[tuple[Keys, str]] = []
        for kind, of in self.sensor_tables.items():
            for i, e in enumerate(of):
                at = (kind, i, "channel")
                if e.channel in conventions.RESERVED_COLUMNS:
                    found.append((at, message("error.is_another_column", channel=e.channel)))
                if taken[e.channel] > 1:
                    found.append((at, message("error.is_another_channel", channel=e.channel)))
                found += [((kind, i, key) if key else (kind, i), text) for key, text in e.faults(self)]
        refuse(found)

    @property
    def sensor_tables(self) -> dict[str, tuple[SensorTable, ...]]:
        """Its sensors other than cables, by the names of their tables."""
        return {name: getattr(self, name) for name in type(self).model_fields if name in TABLES}

    @property
    def sensors(self) -> tuple[SensorTable, ...]:
        """Its sensors other than cables."""
        return tuple(sensor for of in self.sensor_tables.values() for sensor in of)

    @property
    def measures_turns(self) -> bool:
        """Return whether a sensor may measure the orientation of the tool besides positions of its points."""
        return any(sensor.kind not in ("swivel", "distance") for sensor in self.sensors)

    def parameter_names(self) -> list[str]:
        """Names that `assumed` may hold: `<observation point>.<key>`, drum keys included, and `<attachment point>`."""
        keys = [k for k in ObservationPoint.model_fields if k not in {"name", "drum"} and not k.startswith("u_")]
        keys += [k for k in Drum.model_fields if not k.startswith("u_") and k != "zero_exact"]
        return [f"{p.name}.{k}" for p in self.observation_point for k in keys] + list(self.tool)

    def typical(self, key: str, of: float = 1.0) -> float:
        """Return the typical standard uncertainty for a missing key of this rig; of: the value for a relative size."""
        if self.unstated == "exact":
            return 0.0
        size = TYPICAL_SIZES[key]
        return size.value * of if size.relative else size.value

    def point(self, name: str) -> ObservationPoint:
        """The observation point of that name."""
        return next(p for p in self.observation_point if p.name == name)

    @property
    def passes(self) -> int:
        """Return how many passes of the motion the cables need."""
        return max(c.passage for c in self.cable)

    @property
    def channels(self) -> tuple[str, ...]:
        """The counter channels of the cables, each once, in the cables' order."""
        return tuple(dict.fromkeys(c.channel for c in self.cable))

    def drums_of(self, passage: int = 1) -> dict[str, Drum]:
        """The drum that each channel counts in one pass."""
        return {c.channel: self.point(c.from_point).drum for c in self.cables_of(passage)}

    @property
    def observed(self) -> tuple[Observed, ...]:
        """All channels of readings, of all passes: the cables, then the other sensors."""
        of_sensors = [(sensor, sensor.ends(self)) for sensor in self.sensors]
        return (*self.cable, *(SensorChannel(s, *end, again=len(ends) > 1) for s, ends in of_sensors for end in ends))

    def counter(self, observed: Observed) -> Drum | SensorTable:
        """Return the drum or sensor that counts a channel."""
        return observed.table if isinstance(observed, SensorChannel) else self.point(observed.from_point).drum

    def with_sensors(self, changes: Callable[[SensorTable], Mapping[str, Any]]) -> Self:
        """The rig with keys of its sensors other than cables changed, as a function of each has them."""
        every = {k: tuple(s.model_copy(update=changes(s)) for s in of) for k, of in self.sensor_tables.items()}
        return self.model_copy(update=every)

    def counters_of(self, passage: int = 1) -> dict[str, Drum | SensorTable]:
        """Return the drum or sensor of each column of a pass's counts."""
        return {o.channel: self.counter(o) for o in self.observed if o.passage == passage}

    @property
    def can_table(self) -> RawCan | DbcCan | CanOpenCan | J1939Can:
        """The `[can]` table, or the default frames of CiA 406 encoders."""
        return self.can or default_can(self.all_channels)

    @property
    def all_channels(self) -> tuple[str, ...]:
        """The counter channels of the cables, then those of the encoders of angles."""
        return (*self.channels, *(e.channel for e in self.sensors))

    def cables_of(self, passage: int) -> tuple[Cable, ...]:
        """The cables measured in one pass."""
        return tuple(c for c in self.cable if c.passage == passage)

    def cable_rows(self, cables: tuple[Observed, ...] | None = None) -> FloatArray:
        """(m, columns) rows of the kernels (`lmeasure.kernels.layout`) for the given channels, default all cables: mm and rad, B and u in
        the base frame, P in the tool frame."""
        chosen = self.cable if cables is None else cables
        return np.array([self._row(o) for o in chosen]).reshape(len(chosen), kernels.CABLE_COLUMNS)

    def _row(self, o: Observed) -> FloatArray:
        row = np.zeros(kernels.CABLE_COLUMNS)
        if isinstance(o, SensorChannel):
            o.table.fill(self, o, row)
            return row
        p = self.point(o.from_point)
        row[kernels.COUNT_LENGTH], row[kernels.TURN_COUNTS] = p.drum.per_count, p.drum.counts_per_revolution
        fill_point(self, o.from_point, row)
        row[kernels.ATTACHMENT_XYZ], row[kernels.RADIUS] = self.tool[o.to_point], p.pulley_radius_mm
        row[kernels.TANGENT], row[kernels.TRAVEL] = p.drum.tangent_length_mm, p.drum.axial_per_count_mm
        row[kernels.AXIAL] = p.drum.axial_offset_mm + row[kernels.TRAVEL] * self._paid_out.get(o.name, 0.0)
        return row

    def zeroed_at(self, poses: FloatArray, counts: FloatArray | None = None, cables: tuple[Observed, ...] | None = None) -> Self:
        """Return the rig with its counters zeroed at a pose (7,), or at one pose for each of m cables, (m, 7); default all.

        The pay-out point of a drum is where the cable lengths there put it, if the rig states `zero_length_mm`. counts (m,): true counts
        at the poses, 0 by default.
        """
        out, every = self.model_copy(), self.cable if cables is None else cables
        out._paid_out, out._zeroing = {}, _Zeroing(poses, counts, every)
        stated = {j: c for j, c in enumerate(every) if isinstance(c, Cable) and c.zero_length_mm is not None}
        if stated:
            own, chosen = list(stated), tuple(stated.values())
            rows, at = out.cable_rows(chosen), np.ascontiguousarray(np.broadcast_to(poses, (len(every), 7))[own])
            longer = np.diag(kernels.span_lengths(rows, at)) - np.array([c.zero_length_mm for c in chosen])
            k = kernels.counts_from_changes(rows, longer[None])[0] - (0.0 if counts is None else counts[own])
            out._paid_out = {c.name: float(paid) for c, paid in zip(chosen, k, strict=True) if np.isfinite(paid)}
        return out

    def paid_out(self, cables: tuple[Observed, ...] | None = None) -> FloatArray:
        """(m,) true counts from `zero_length_mm` to where the counters were zeroed, default of all cables; 0 where it is not stated."""
        return np.array([self._paid_out.get(o.name, 0.0) for o in (self.cable if cables is None else cables)])

    def paid_out_since(self, lengths_mm: Mapping[str, float]) -> FloatArray:
        """(m,) true counts of all cables from other lengths, by cable, to where the counters were zeroed (`zeroed_at`).

        A cable without a length takes that of another from the same drum. 0 of one that states `zero_length_mm`, or whose zeroing is not
        known.
        """
        poses, counts, every = self._zeroing.poses, self._zeroing.counts, self._zeroing.cables
        if poses is None or not lengths_mm:
            return np.zeros(len(self.cable))
        of_drum = {c.from_point: lengths_mm[c.name] for c in self.cable if c.name in lengths_mm}

        def other(o: Observed) -> Observed:
            if isinstance(o, SensorChannel) or o.zero_length_mm is not None:
                return o
            return o.model_copy(update={"zero_length_mm": lengths_mm.get(o.name, of_drum.get(o.from_point))})

        since = self.zeroed_at(poses, counts, tuple(map(other, every)))._paid_out
        return np.array([since.get(c.name, 0.0) if c.zero_length_mm is None else 0.0 for c in self.cable])

    def scales(self, cables: tuple[Observed, ...] | None = None) -> FloatArray:
        """(m,) decoding scales of the channels' counters, default of all cables."""
        return np.array([self.counter(o).scale for o in (self.cable if cables is None else cables)])

    def zeroings(self, cables: tuple[Observed, ...] | None = None) -> IntArray:
        """(m,) which zeroing of a counter each cable is counted from, numbered from 0 in the order of the cables, default all.

        A channel that leads the same cable, from and to, in passes that follow one another on it is taken not to be zeroed again between
        them. To lead another it has to be taken off at the start pose, fastened there and zeroed.
        """
        zeroing: dict[tuple[str, int], int] = {}
        led: dict[str, tuple[str, str, int]] = {}
        for c in sorted(self.observed, key=lambda c: c.passage):
            before = led.get(c.channel)
            same = before is not None and before[:2] == (c.from_point, c.to_point)
            led[c.channel] = c.from_point, c.to_point, before[2] if before is not None and same else c.passage
            zeroing[c.channel, c.passage] = led[c.channel][2]
        begun = [(c.channel, zeroing[c.channel, c.passage]) for c in (self.cable if cables is None else cables)]
        number = {key: i for i, key in enumerate(dict.fromkeys(begun))}
        return np.array([number[key] for key in begun], dtype=np.int64)

    def require_pose(self, redundant: bool = False) -> None:
        """Raise RigError unless the cables determine a whole pose: six of them, or more if allowed, to attachment points that do not lie on
        one line."""
        if len(self.cable) < CABLES_FOR_A_POSE or (len(self.cable) > CABLES_FOR_A_POSE and not redundant):
            numbers = {"n_cable": len(self.cable), "value": "at least" if redundant else "exactly", "cables_for_a_pose": CABLES_FOR_A_POSE}
            raise RigError(message("error.rig_has_cables_a", name=self.name, **numbers))
        self.require_spread()

    def require_spread(self) -> None:
        """RigError when the attachment points lie on one line: no cable sees a turn about it."""
        used = sorted({c.to_point for c in self.observed if c.to_point})
        points = np.array([self.tool[name] for name in used])
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if len(used) < 3 or spread[1] < 1e-6 * max(spread[0], 1e-9) or spread[1] < 1e-3:
            raise RigError(message("error.rig_tool_the_attachment", name=self.name, used=", ".join(used)))

    def without_effects(self) -> Self:
        """The rig with cables of fixed length: nothing stated of temperature, tension and weight, drums and pulleys that run true."""
        nothing: dict[str, None] = dict.fromkeys((*CableOnDrum.model_fields, *Drum.UNTRUE))
        true: dict[str, Any] = dict.fromkeys(ObservationPoint.UNTRUE)
        points = tuple(p.model_copy(update={"drum": p.drum.model_copy(update=nothing)} | true) for p in self.observation_point)
        frame = dict.fromkeys(("frame_expansion_per_k", "u_frame_expansion_per_k", "u_temperature_k"))
        return self.model_copy(update={"observation_point": points} | frame)

    def to_dict(self) -> dict[str, Any]:
        """The content of rig.toml, optional keys left out where they are not set."""
        data = self.model_dump(by_alias=True, exclude_none=True, mode="json")
        # otherwise the file would state a limit that was not stated
        for point, table in zip(self.observation_point, data["observation_point"], strict=True):
            if not point.drum.rate_stated:
                del table["drum"]["max_cable_speed_mm_s"]
        for kind, sensors in self.sensor_tables.items():
            for sensor, table in zip(sensors, data[kind], strict=True):
                if not sensor.rate_stated:
                    del table[sensor.rate_key]
        # rigs without sensors, and digests of them, do not have these keys
        return {
            key: value
            for key, value in data.items()
            if (value or key not in self.sensor_tables) and (key, value) != ("unstated", "typical")
        }

    def __reduce__(self) -> tuple[Any, ...]:
        # the model of a rig with sensors of other packages is made in each process
        return (_again, (self.to_dict(), self._paid_out))


def cables_among(channels: Iterable[Observed]) -> tuple[Cable, ...]:
    """Return the cables of some channels."""
    return tuple(c for c in channels if isinstance(c, Cable))


def _references(data: Mapping[str, Any]) -> Iterator[tuple[Keys, str]]:
    """Yield contradictions in the names of a rig.toml's content, whatever else is wrong: (keys, fault)."""
    lists = {key: data.get(key) for key in ("observation_point", "cable")}
    tables = {key: [t for t in value if isinstance(t, dict)] if isinstance(value, list) else [] for key, value in lists.items()}
    points, tool = [p.get("name") for p in tables["observation_point"]], data.get("tool")
    # a point whose name is missing or no text may be the one that is meant, and is complained of itself
    named_all = all(isinstance(p, str) for p in points)
    for kind, named in tables.items():
        for i, table in enumerate(named):
            if isinstance(name := table.get("name"), str) and name in [t.get("name") for t in named[:i]]:
                yield (kind, i, "name"), message("error.the_name_is_given", name=name, times=sum(t.get("name") == name for t in named))
    served: set[tuple[str, int]] = set()
    for i, c in enumerate(tables["cable"]):
        channel, start, end, passage = c.get("channel"), c.get("from"), c.get("to"), c.get("pass", 1)
        if isinstance(channel, str) and channel in conventions.RESERVED_COLUMNS:
            yield ("cable", i, "channel"), message("error.is_another_column", channel=channel)
        if named_all and isinstance(start, str) and start not in points:
            known = ", ".join(map(str, dict.fromkeys(points)))
            yield ("cable", i, "from"), message("error.is_no_observation_point", name=start, known=known)
        if isinstance(end, str) and isinstance(tool, dict) and end not in tool:
            yield ("cable", i, "to"), message("error.is_no_point_of_tool", name=end, known=", ".join(tool))
        if isinstance(channel, str) and isinstance(passage, int) and not isinstance(passage, bool):
            if (channel, passage) in served:
                yield ("cable", i, "channel"), message("error.serves_another_cable", channel=channel, passage=passage)
            served.add((channel, passage))


@cache
def _model(names: tuple[str, ...]) -> type[Rig]:
    """The model of rigs that have tables of sensors of other packages."""
    fields: dict[str, Any] = {name: (tuple.__class_getitem__((TABLES[name], ...)), ()) for name in names}
    return create_model("Rig", __base__=Rig, **fields)


def _again(data: dict[str, Any], paid_out: dict[str, float]) -> Rig:
    out = rig_from_dict(data)
    out._paid_out = paid_out
    return out


def rig_from_dict(data: dict[str, Any], source: str = "rig") -> Rig:
    """Make a checked rig from the content of a rig.toml.

    Parameters
    ----------
    data
        Content of a rig.toml.
    source
        Name that messages give to the source.

    Returns
    -------
    Rig
        The instrument.

    Raises
    ------
    RigError
        If a key is wrong. The message names source and key.

    Examples
    --------
    >>> lm.rig_from_dict(rig.model_dump(by_alias=True, exclude_none=True)) == rig
    True
    """
    if "schema" not in data:
        raise RigError(message("error.schema_is_missing_this", where=source))
    known = {field.alias or name for name, field in Rig.model_fields.items()}
    more = tuple(key for key in data if key not in known and table_of(key) is not None)
    return checked(data, _model(more) if more else Rig, source, RigError, also=_references)


def read_rig(path: Path) -> Rig:
    """Read and check a rig.toml.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Rig
        The instrument.

    Raises
    ------
    RigError
        If the file is wrong. The message names file, line and key.

    Examples
    --------
    >>> lm.read_rig(Path("rig.toml")).name
    'simulated cell 1'
    """
    return rig_from_dict(files.read_toml(path), str(path))


def write_rig(path: Path, rig: Rig) -> None:
    """Write a rig.toml, complete or not at all.

    Parameters
    ----------
    path
        File to write.
    rig
        The rig.

    Examples
    --------
    >>> lm.write_rig(Path("rig.toml"), rig)
    """
    files.write_toml(path, rig.to_dict())
