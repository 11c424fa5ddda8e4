"""Scenarios: scenario.toml states the motion of a rig, and the recording of it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from lmeasure.core import QUATERNION_COLUMNS, TEMPERATURE_RANGE_C, DataFrame, FileFormatError, FloatArray, Shown, framed
from lmeasure.io import Strict, checked, files, of_key
from lmeasure.recording import POSITION_COLUMNS, pose_columns, poses_from_rows, write_poses, write_run
from lmeasure.rig import Rig, Unstated, read_linked_rig, rig_from_dict, write_rig
from lmeasure.simulation.cell import WORK_SPACE_MM, WORK_TILT_RAD, cell_rig
from lmeasure.simulation.instrument import SimulatedCampaign, SimulatedRun, simulate_campaign, simulate_run
from lmeasure.simulation.motion import Leg, smooth_path
from lmeasure.text import Lines, message

Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
Temperature = Annotated[float, Field(ge=TEMPERATURE_RANGE_C[0], le=TEMPERATURE_RANGE_C[1])]
Position = tuple[Coordinate, Coordinate, Coordinate]


def _unit(value: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    length = math.hypot(*value)
    if abs(length - 1.0) > 1e-6:
        raise ValueError(message("error.the_quaternion_s_length_is", length=length))
    return value[0] / length, value[1] / length, value[2] / length, value[3] / length


Quaternion = Annotated[tuple[float, float, float, float], AfterValidator(_unit)]


class Start(Strict):
    """Pose at which counters are zeroed and the motion starts."""

    position_mm: Position = (0.0, 0.0, 0.0)
    """Position of the tool origin, base frame."""
    quaternion_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    """Orientation base_from_tool."""


class Waypoint(Strict):
    """Stop of the motion. Omitted speeds and rests are those of `[motion]`."""

    position_mm: Position
    """Position of the tool origin, base frame."""
    quaternion_xyzw: Quaternion | None = None
    """Orientation base_from_tool; default: that of the previous waypoint."""
    speed_mm_s: Annotated[float, Field(gt=0, le=1e6)] | None = None
    """Largest speed on the way to this stop."""
    rotation_speed_deg_s: Annotated[float, Field(gt=0, le=1e5)] | None = None
    """Largest angular speed on the way to this stop."""
    dwell_s: Annotated[float, Field(ge=0, le=1e5)] | None = None
    """Rest at this stop."""


class Motion(Strict):
    """Speeds, rests and repetitions of the motion."""

    speed_mm_s: Annotated[float, Field(gt=0, le=1e6)] = 500.0
    """Largest speed."""
    rotation_speed_deg_s: Annotated[float, Field(gt=0, le=1e5)] = 60.0
    """Largest angular speed."""
    dwell_s: Annotated[float, Field(ge=0, le=1e5)] = 0.2
    """Rest at each waypoint."""
    cycles: Annotated[int, Field(ge=1, le=100_000)] = 1
    """Repetitions of the sequence of waypoints."""
    back_to_start: bool = True
    """true: each cycle ends at the start."""


class ReferencePoses(Strict):
    """Calibration campaign: random poses around the start, measured with the stated uncertainty."""

    count: Annotated[int, Field(ge=1, le=100_000)] = 12
    """Number of poses."""
    half_mm: tuple[Coordinate, Coordinate, Coordinate] = (WORK_SPACE_MM, WORK_SPACE_MM, WORK_SPACE_MM)
    """Half the edge lengths of the box of positions around the start, base frame."""
    tilt_rad: Annotated[float, Field(ge=0, le=math.pi)] = WORK_TILT_RAD
    """Largest component of the rotation vectors from the start."""
    u_position_mm: Annotated[float, Field(ge=0, le=1e3)] = 0.0
    """Standard uncertainty of the measured positions, per coordinate."""
    u_rotation_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Standard uncertainty of the measured orientations, per axis."""
    nominal_shift_mm: Annotated[float, Field(ge=0, le=1e3)] = 30.0
    """Largest error of the nominal observation points, per axis."""
    nominal_shift_deg: Annotated[float, Field(ge=0, le=45)] = 5.0
    """Largest error of the nominal guide angles."""


class TestedRobot(Strict):
    """Robot that moves the tool. Its controller uses the nominal model; the simulated robot has errors."""

    model: Annotated[str, Field(min_length=1)]
    """Name of a robot, such as rotopod-cell or ur5, or a robot.toml beside this file."""
    position_mm: Position | None = None
    """Position of the robot's base in the rig's base frame; default: home puts the tool at the start."""
    quaternion_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    """Orientation of the robot's base in the rig's base frame, used with `position_mm`."""
    commands: str | None = None
    """File beside this one: commands.csv of `program`, or joint values of `plan-poses --robot`. Default: the waypoints."""
    errors: dict[str, Annotated[float, Field(ge=-1e4, le=1e4)]] = Field(default_factory=dict)
    """Errors of parameters by name, true minus nominal: "leg_1.rod_mm" = 0.3."""
    u_mm: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Standard deviation of random errors of all other lengths of links or legs."""
    u_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Standard deviation of random errors of all other angles."""
    repeatability_mm: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Standard deviation of the position of a sliding joint, drawn at every command."""
    repeatability_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Standard deviation of the position of a turning joint, drawn at every command."""
    stiffness_n_mm: Annotated[float, Field(gt=0, le=1e12)] = 2e4
    """Stiffness of a sliding joint under load [N/mm]."""
    stiffness_nm_deg: Annotated[float, Field(gt=0, le=1e12)] = 2e4
    """Stiffness of a turning joint under load [N m/deg]."""


class Scenario(Strict):
    """Scenario of a simulation: rig, motion and calibration campaign."""

    schema_: Annotated[Literal["lmeasure.scenario/1"], Field(alias="schema")]
    """Kind and version of the file."""
    rig: str | dict[str, Any] | None = None
    """Rig file beside this one, or a rig as a table; default: the built-in cell."""
    unstated: Unstated = "exact"
    """`unstated` of the files written: exact, the simulated parts and the start have no other errors; typical, as of a real rig."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of all random numbers; equal seeds give equal counts."""
    rate_hz: Annotated[float, Field(gt=0, le=1e6)] = 1000.0
    """Sampling rate."""
    noise_mm: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Standard deviation of the noise of lengths."""
    noise_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Standard deviation of the noise of angle encoders."""
    temperature_c: Temperature | None = None
    """Temperature at the start; recorded if stated."""
    end_temperature_c: Temperature | None = None
    """Temperature at the end of the motion and at the last reference pose; the change is linear."""
    start: Start = Start()
    """Start of the motion."""
    motion: Motion = Motion()
    """Speeds, rests and repetitions."""
    waypoint: tuple[Waypoint, ...] = ()
    """Stops of the motion, one table `[[waypoint]]` each; default: no run."""
    reference_poses: ReferencePoses | None = None
    """Calibration campaign; default: none."""
    robot: TestedRobot | None = None
    """Robot that moves the tool; default: every waypoint is reached exactly."""

    def temperatures(self, count: int) -> FloatArray | None:
        """(count,) temperatures from the start to the end [deg C]; None where none is given."""
        if self.temperature_c is None:
            return None
        return np.linspace(self.temperature_c, self.temperature_c if self.end_temperature_c is None else self.end_temperature_c, count)

    @model_validator(mode="after")
    def _does_something(self) -> Self:
        commanded = self.robot is not None and self.robot.commands is not None
        if not self.waypoint and not commanded and self.reference_poses is None:
            raise ValueError(message("error.nothing_to_simulate_give"))
        if self.robot is not None and bool(self.waypoint) == commanded:
            raise of_key("robot", message("error.goes_through_waypoint_or"))
        if self.end_temperature_c is not None and self.temperature_c is None:
            raise of_key("end_temperature_c", message("error.needs_temperature_c_which"))
        return self

    @property
    def start_pose(self) -> FloatArray:
        """(7,) pose at which the counters are zeroed."""
        return np.array([*self.start.position_mm, *self.start.quaternion_xyzw])

    def legs(self) -> list[Leg]:
        """The ways from waypoint to waypoint, all cycles."""
        points = list(self.waypoint)
        if self.motion.back_to_start:
            points.append(Waypoint(position_mm=self.start.position_mm, quaternion_xyzw=self.start.quaternion_xyzw))
        out, quaternion = [], self.start.quaternion_xyzw
        for w in points * self.motion.cycles:
            quaternion = w.quaternion_xyzw or quaternion
            out.append(
                Leg(
                    np.array([*w.position_mm, *quaternion]),
                    self.motion.speed_mm_s if w.speed_mm_s is None else w.speed_mm_s,
                    math.radians(self.motion.rotation_speed_deg_s if w.rotation_speed_deg_s is None else w.rotation_speed_deg_s),
                    self.motion.dwell_s if w.dwell_s is None else w.dwell_s,
                )
            )
        return out


@dataclass(frozen=True, repr=False)
class Simulated(Shown):
    """Result of a scenario: a run for waypoints, a campaign on request."""

    run: SimulatedRun | None
    campaign: SimulatedCampaign | None

    def about(self) -> dict[str, str]:
        """Its parts."""
        parts = {} if self.run is None else {"run": f"{len(self.run.poses)} samples over {self.run.run.passes[0].time_s[-1]:.6g} s"}
        return parts if self.campaign is None else parts | {"campaign": f"{len(self.campaign.poses)} reference poses"}

    def to_frame(self) -> DataFrame:
        """The true poses: of the run's samples with their times, else of the reference poses."""
        poses = self.run.poses if self.run is not None else self.campaign.poses if self.campaign is not None else np.empty((0, 7))
        time_s = {} if self.run is None else {"time_s": self.run.run.passes[0].time_s}
        return framed(time_s | dict(zip(("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"), poses.T, strict=True)))

    def summary(self) -> str:
        """A line for a person on each part."""
        lines = []
        if self.run is not None:
            counts, passes = self.run.run.passes[0], len(self.run.run.passes)
            counted = {"samples": len(counts.time_s), "seconds": counts.time_s[-1], "channels": tuple(counts.channels)}
            lines.append(message("simulation.samples_passes", passes=passes, **counted))
        if self.campaign is not None:
            lines.append(message("simulation.reference_poses_calibration_true", count=len(self.campaign.poses)))
        return Lines(lines)


def read_scenario(path: Path) -> tuple[Scenario, Rig]:
    """Read scenario.toml and the rig it names; FileFormatError names the file and the key."""
    return scenario_from_dict(files.read_toml(path), str(path), Path(path).parent)


def scenario_from_dict(data: Mapping[str, Any], source: str = "scenario", folder: Path | None = None) -> tuple[Scenario, Rig]:
    """The scenario of a scenario.toml's content, and the rig it names, in the folder if not in the working directory; source is named in
    errors."""
    scenario = checked(data, Scenario, source)
    if scenario.rig is None:
        return scenario, cell_rig(scenario.seed)
    if isinstance(scenario.rig, str):
        return scenario, read_linked_rig((folder or Path()) / scenario.rig)[0].model_copy(update={"calibration": None})
    return scenario, rig_from_dict(scenario.rig, f"{source}: rig")


def simulate(scenario: Scenario, rig: Rig, went: tuple[FloatArray, FloatArray] | None = None) -> Simulated:
    """Run the forward model; the same scenario and rig give the same counts. GeometryError when a cable cannot run at a pose.

    went: times (n,) and poses (n, 7) of another motion than straight through the waypoints; a scenario's robot needs them
    (`lmeasure.iso9283.program.command_files`), FileFormatError without.
    """
    rng = np.random.default_rng(scenario.seed)
    run, campaign = None, None
    if scenario.robot is not None and went is None:
        raise FileFormatError(message("error.scenario_its_robot_moves"))
    if scenario.waypoint or went is not None:
        time_s, poses = smooth_path(scenario.start_pose, scenario.legs(), scenario.rate_hz) if went is None else went
        noise = {"noise_mm": scenario.noise_mm, "noise_deg": scenario.noise_deg}
        run = simulate_run(rig, time_s, poses, rng=rng, temperature_c=scenario.temperatures(len(time_s)), **noise)
    if scenario.reference_poses is not None:
        requested = scenario.reference_poses
        errors: dict[str, Any] = {"u_position_mm": requested.u_position_mm, "u_rotation_rad": math.radians(requested.u_rotation_deg)}
        errors |= {"nominal_shift_mm": requested.nominal_shift_mm, "nominal_shift_deg": requested.nominal_shift_deg}
        errors |= {"half_mm": requested.half_mm, "tilt_rad": requested.tilt_rad, "temperature_c": scenario.temperatures(requested.count)}
        campaign = simulate_campaign(rig, requested.count, rng, centre=scenario.start_pose, **errors)
    if scenario.unstated == "exact":
        return Simulated(run, campaign)
    return Simulated(
        None if run is None else replace(run, run=replace(run.run, rig=_typical(run.run.rig), unstated="typical")),
        None if campaign is None else replace(campaign, nominal=_typical(campaign.nominal), true=_typical(campaign.true)),
    )


def _typical(rig: Rig) -> Rig:
    return rig.model_copy(update={"unstated": "typical"})


def write_simulated(folder: Path, simulated: Simulated) -> None:
    """Write the run folder with `truth.parquet` beside its counts, and the calibration folder `calibration/` with the true rig."""
    folder = Path(folder)
    if simulated.campaign is not None:
        write_campaign(folder / "calibration", simulated.campaign)
    if simulated.run is not None:
        rows = simulated.run.poses
        columns = {"time_s": simulated.run.run.passes[0].time_s}
        columns |= dict(zip((*POSITION_COLUMNS, *QUATERNION_COLUMNS), rows.T, strict=True))
        files.write_table(folder / "truth.parquet", columns)
        write_run(folder, simulated.run.run)


def write_campaign(folder: Path, campaign: SimulatedCampaign) -> None:
    """Write a calibration folder: nominal rig.toml, reference_poses.csv, counts.csv; the true rig and poses in `true/`."""
    folder = Path(folder)
    write_rig(folder / "true" / "rig.toml", campaign.true)
    write_poses(folder / "true" / "reference_poses.csv", poses_from_rows(campaign.poses))
    write_rig(folder / "rig.toml", campaign.nominal)
    poses = pose_columns(campaign.measured, campaign.nominal.angles)
    if campaign.temperature_c is not None:
        poses["temperature_c"] = campaign.temperature_c
    files.write_table(folder / "reference_poses.csv", poses)
    columns: dict[str, Any] = {"pose": list(campaign.measured.names)}
    columns |= {name: campaign.recorded[:, i].astype(np.int64) for i, name in enumerate(campaign.channels)}
    files.write_table(folder / "counts.csv", columns)
