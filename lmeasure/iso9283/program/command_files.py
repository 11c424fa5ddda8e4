"""A list of commands for the people and programs that make a robot run it."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
from scipy.spatial.transform import Slerp

from lmeasure.core import QUATERNION_COLUMNS, FileFormatError, FloatArray, IntArray, conventions, se3
from lmeasure.io import files
from lmeasure.iso9283.program.campaign import CIRCLE_STEPS, Campaign
from lmeasure.recording import POSITION_COLUMNS, CommandedPose, Program, write_program
from lmeasure.rig import Rig
from lmeasure.robots import (
    AnyRobot,
    Command,
    Mounted,
    ParallelFile,
    Performance,
    PlatformFile,
    Role,
    SimulatedRobot,
    any_shipped,
    checked,
    family,
    joint_columns,
    read_measurements,
    read_robot,
    shipped_names,
    write_robot,
)
from lmeasure.simulation import Scenario, Simulated, TestedRobot, simulate, write_simulated
from lmeasure.text import message

ROBODK_CIRCLE_POINTS = 36


def write_campaign(out: Path, plan: Campaign) -> None:
    """program.toml, commands.csv and robodk.csv in the folder out: all of them or none, for they belong together."""
    with (
        files.whole(out / "program.toml") as program,
        files.whole(out / "commands.csv") as commands,
        files.whole(out / "robodk.csv") as robodk,
    ):
        write_program(program, plan.program)
        write_commands(commands, plan)
        write_robodk(robodk, plan)


def write_commands(path: Path, plan: Campaign) -> None:
    """Write one row per move (.csv or .parquet): linear, or by arcs; a circle has two, each with an intermediate point (`via`).

    Columns: command (from 1), target, role, cycle, move, pose, speed_mm_s, dwell_s behind the move, load_kg, and the force at the tool.
    """
    circles = {p.name for p in plan.program.path if p.kind == "circular"}
    rows, owners, moves = [], [], []
    for number, command in enumerate(plan.commands):
        kept = _quarters(command) if command.target in circles and len(command.poses) == CIRCLE_STEPS else None
        poses = command.poses if kept is None else command.poses[kept]
        rows.append(poses)
        owners += [number] * len(poses)
        moves += ["linear"] * len(poses) if kept is None else ["via", "arc"] * (len(poses) // 2)
    owner = np.array(owners)
    last = np.append(np.diff(owner) > 0, True)

    def of(key: str) -> list[Any]:
        return [getattr(plan.commands[i], key) for i in owners]

    columns: dict[str, Any] = {
        "command": owner + 1,
        "target": of("target"),
        "role": [plan.commands[i].role if plan.commands[i].target else "" for i in owners],
    }
    columns |= {"cycle": np.array(of("cycle")), "move": moves}
    columns |= dict(zip((*POSITION_COLUMNS, *QUATERNION_COLUMNS), np.concatenate(rows).T, strict=True))
    columns |= {"speed_mm_s": np.array(of("speed_mm_s")), "dwell_s": np.where(last, of("dwell_s"), 0.0), "load_kg": np.array(of("load_kg"))}
    columns |= dict(zip(("force_x_n", "force_y_n", "force_z_n"), np.array(of("force_n")).T, strict=True))
    files.write_table(path, columns)


def read_commands(path: Path) -> tuple[Command, ...]:
    """Return the commands of such a list for a performance; arcs are straight pieces of a circle's `CIRCLE_STEPS`-th.

    FileFormatError names the file and the missing part.
    """
    table = files.read_table(path)
    if len(table) == 0:
        raise FileFormatError(message("error.holds_no_command", where=path))
    rows = table.matrix((*POSITION_COLUMNS, *QUATERNION_COLUMNS))
    number, move = table.numbers("command"), table.text("move")
    target, role = table.text("target"), table.text("role")
    speed, dwell, load, cycle = (table.numbers(name) for name in ("speed_mm_s", "dwell_s", "load_kg", "cycle"))
    force = table.matrix(("force_x_n", "force_y_n", "force_z_n"))
    edges = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(number)]
    out, here = [], rows[0]
    for first, end in itertools.pairwise(edges):
        poses = _with_arcs(path, here, rows[first:end], move[first:end])
        role_of = role[first] or "pose"
        if role_of not in get_args(Role):
            raise FileFormatError(
                message("error.line_role_is_none", where=path, first=first + 2, role_of=role_of, options=", ".join(get_args(Role)))
            )
        named = Command(poses, float(speed[first]), float(dwell[end - 1]), target[first], cast(Role, role_of), int(cycle[first]))
        out.append(replace(named, load_kg=float(load[first]), force_n=force[first]))
        here = rows[end - 1]
    return tuple(out)


def _with_arcs(path: Path, here: FloatArray, rows: FloatArray, move: Sequence[str]) -> FloatArray:
    """(k, 7) poses of the way through rows (n, 7), the first from here (7,): `via` and `arc` are a circle's piece through three points."""
    out: list[FloatArray] = []
    for i, kind in enumerate(move):
        if kind == "linear":
            out.append(rows[i][None])
        elif kind == "arc" and i > 0 and move[i - 1] == "via":
            out.append(_arc(path, here if i == 1 else rows[i - 2], rows[i - 1], rows[i]))
        elif kind != "via":
            raise FileFormatError(message("error.move_is_none_of", where=path, kind=kind))
    return np.concatenate(out)


def _arc(path: Path, first: FloatArray, via: FloatArray, last: FloatArray) -> FloatArray:
    """(k, 7) poses behind the first on the arc from it through via to the last; it turns evenly from one orientation to the next."""
    a, b = via[:3] - first[:3], last[:3] - first[:3]
    normal = np.cross(a, b)
    if normal @ normal < 1e-12 * (a @ a) * (b @ b):
        raise FileFormatError(message("error.three_points_of_an", where=path))
    # from the first point to the centre of the circle through three points
    centre = first[:3] + np.cross((a @ a) * b - (b @ b) * a, normal) / (2.0 * (normal @ normal))
    out = first[:3] - centre
    axis = normal / np.linalg.norm(normal)
    across = np.cross(axis, out)
    at = [0.0, *(math.atan2(float((p[:3] - centre) @ across), float((p[:3] - centre) @ out)) % (2.0 * math.pi) for p in (via, last))]
    turn = at[2]
    angles = np.linspace(0.0, turn, max(2, round(turn / (2.0 * math.pi) * CIRCLE_STEPS) + 1))[1:]
    places = centre + np.cos(angles)[:, None] * out + np.sin(angles)[:, None] * across
    return se3.pose(places, Slerp(at, se3.rotation(np.array([first, via, last])))(angles))


def write_robodk(path: Path, plan: Campaign) -> None:
    """Targets as RoboDK's script ImportCSV_XYZWPR reads them: no header; x, y, z [mm], rx, ry, rz [deg] of Rz Ry Rx, the command's number.

    A circle is 36 targets. Speeds and rests have no place in this file.
    """
    lines = []
    for number, command in enumerate(plan.commands, 1):
        every = max(1, len(command.poses) // ROBODK_CIRCLE_POINTS) if len(command.poses) == CIRCLE_STEPS else 1
        poses = command.poses[every - 1 :: every]
        angles = conventions.angles_from_rotation("fanuc-wpr", se3.rotation(poses))
        lines += [", ".join([*(repr(float(v)) for v in (*pose[:3], *turn)), str(number)]) for pose, turn in zip(poses, angles, strict=True)]
    files.write_text(path, "\n".join(lines) + "\n")


def _quarters(command: Command) -> IntArray:
    """Return the poses of a circle that end its quarters."""
    return np.arange(1, 5) * (len(command.poses) // 4) - 1


NATURAL_RAD_S, DAMPING = 90.0, 0.5
RAMP_S = (0.08, 0.03)
"""Servos of a usual robot, as those of the cell's arm."""


@dataclass(frozen=True)
class RobotRun:
    """Results of a scenario with a robot: counts and true poses, how the robot performed, as drawn and as it was built, the program of
    its rests where the commands' file is none of a program, and remarks."""

    simulated: Simulated
    performance: Performance
    drawn: AnyRobot
    built: AnyRobot
    program: Program | None
    remarks: tuple[str, ...]


def simulate_robot(scenario: Scenario, rig: Rig, folder: Path, source: str = "scenario") -> RobotRun:
    """Let the scenario's robot go through its waypoints, or the program in its file (in the folder if relative), and read the counts.

    By default the robot's base is placed so that its tool at home is at the scenario's start. FileFormatError or RobotError names the
    unreadable part, or the command that the robot cannot carry out.
    """
    settings = scenario.robot
    if settings is None:
        raise FileFormatError(message("error.robot_is_missing", where=source))
    drawn = _drawn(settings.model, folder, source)
    built = _built(settings, drawn, np.random.default_rng([scenario.seed, 1]), source)
    home = _home(drawn)
    if settings.position_mm is None:
        at_home = se3.compose(home, drawn.tool_pose)
        base = se3.compose(scenario.start_pose, se3.inverse(at_home))
    else:
        base = np.array([*settings.position_mm, *settings.quaternion_xyzw])
    nominal, true = (Mounted(robot.model, base, drawn.tool_pose) for robot in (drawn, built))
    sliding = nominal.robot.sliding
    rest = nominal.robot.inverse(home)[0] if isinstance(drawn, PlatformFile) else _rest(drawn)
    units = np.where(sliding, 1.0, np.radians(1.0))
    robot = SimulatedRobot(
        nominal,
        true,
        rest=rest,
        ramp_s=RAMP_S,
        natural_rad_s=np.full(len(rest), NATURAL_RAD_S),
        damping=np.full(len(rest), DAMPING),
        joint_noise_rad=np.where(sliding, settings.repeatability_mm, settings.repeatability_deg) * units,
        backlash_rad=np.zeros(len(rest)),
        stiffness_n_mm_rad=np.where(sliding, settings.stiffness_n_mm, 1e3 * settings.stiffness_nm_deg / np.radians(1.0)),
    )
    programmed, done = _performed(scenario, settings, folder, robot, drawn)
    simulated = simulate(scenario, rig, (done.time_s, done.poses))
    program = None if programmed else _program(drawn, nominal, done)
    return RobotRun(simulated, done, drawn, built, program, _remarks(drawn, nominal, done, programmed=programmed))


def write_robot_run(folder: Path, run: RobotRun) -> None:
    """`write_simulated`, and in `robot/` the drawn robot.toml, joints.csv of every rest and program.toml of the poses there, and in
    `robot/true/` the robot as it was built."""
    folder = Path(folder)
    write_robot(folder / "robot" / "robot.toml", run.drawn)
    write_robot(folder / "robot" / "true" / "robot.toml", run.built)
    done, model = run.performance, run.drawn.model
    time_s = [0.5 * (s.arrival_s + s.end_s) for s, c in zip(done.spans, done.commands, strict=True) if c.dwell_s > 0.0]
    at = np.clip(np.searchsorted(done.time_s, time_s), 0, len(done.time_s) - 1)
    columns = {"name": [f"rest_{i + 1}" for i in range(len(at))], "time_s": np.array(time_s), **joint_columns(model, done.requested[at])}
    files.write_table(folder / "robot" / "joints.csv", columns)
    if run.program is not None:
        write_program(folder / "robot" / "program.toml", run.program)
    write_simulated(folder, run.simulated)


def _drawn(name: str, folder: Path, source: str) -> AnyRobot:
    if not Path(name).suffix:
        if name not in shipped_names():
            raise FileFormatError(message("error.robot_model_is_no", where=source, name=name, shipped_names=", ".join(shipped_names())))
        return any_shipped(name)
    return read_robot(folder / name)


def _built(settings: TestedRobot, drawn: AnyRobot, rng: np.random.Generator, source: str) -> AnyRobot:
    """Return the robot with its errors, drawn ones first."""
    parameters = drawn.model.parameters
    errors = {}
    for p, unit in zip(parameters, rng.normal(size=len(parameters)), strict=True):
        if family(p.name) == "links" and p.unit in ("mm", "deg"):
            errors[p.name] = float(unit) * (settings.u_mm if p.unit == "mm" else settings.u_deg)
    known = {p.name: p.value for p in parameters}
    strange = next((name for name in settings.errors if name not in known), None)
    if strange is not None:
        raise FileFormatError(message("error.robot_errors_is_no", where=source, strange=strange, name=drawn.name, name2=parameters[0].name))
    errors |= settings.errors
    return drawn.with_values({name: known[name] + error for name, error in errors.items() if error != 0.0})


def _performed(scenario: Scenario, settings: TestedRobot, folder: Path, robot: SimulatedRobot, drawn: AnyRobot) -> tuple[bool, Performance]:
    """Return whether it ran a program with a file of its own, and its performance: straight through waypoints or commands, or by its joints
    through a table of their values."""
    motion, rng = scenario.motion, np.random.default_rng([scenario.seed, 2])
    if settings.commands is None:
        ways = [Command(leg.pose[None], leg.speed_mm_s, leg.dwell_s, rotation_rad_s=leg.rotation_speed_rad_s) for leg in scenario.legs()]
        return False, robot.perform(ways, scenario.start_pose, scenario.rate_hz, rng)
    path = folder / settings.commands
    if "move" in files.read_table(path).columns:
        commands = read_commands(path)
        return True, robot.perform(commands, commands[0].poses[0], scenario.rate_hz, rng)
    rows = read_measurements(path, drawn.model, joints_alone=True)
    rates = np.where(drawn.model.sliding, motion.speed_mm_s, np.radians(motion.rotation_speed_deg_s))
    every, names = np.tile(rows.joints, (motion.cycles, 1)), rows.names * motion.cycles
    return False, robot.drive(every, names, scenario.rate_hz, rng, rates=rates, dwell_s=motion.dwell_s)


def _attained(drawn: AnyRobot, nominal: Mounted, poses: FloatArray) -> FloatArray:
    """(N, 7) where the drawing has the tool when it is given poses (N, 7)."""
    return nominal.placed(drawn.model.nearest(nominal.flange(poses))) if isinstance(drawn, ParallelFile) else poses


def _program(drawn: AnyRobot, nominal: Mounted, done: Performance) -> Program | None:
    """Return the program whose rests `certify` evaluates: each pose once, by its name or as P1, P2, ..., with the second half of each rest
    there, after its servos have settled, as a window."""
    rests = [(c, s) for c, s in zip(done.commands, done.spans, strict=True) if c.dwell_s > 0.0]
    if not rests:
        return None
    poses = _attained(drawn, nominal, np.array([command.poses[-1] for command, _ in rests]))
    windows: dict[str | bytes, list[tuple[float, float]]] = {}
    at: dict[str | bytes, FloatArray] = {}
    for (command, span), pose in zip(rests, poses, strict=True):
        key = command.target or command.poses[-1].round(9).tobytes()
        at.setdefault(key, pose)
        windows.setdefault(key, []).append((0.5 * (span.arrival_s + span.end_s), span.end_s))
    own = tuple(
        CommandedPose(
            name=key if isinstance(key, str) else f"P{number}",
            position_mm=tuple(at[key][:3]),
            quaternion_xyzw=tuple(at[key][3:]),
            windows_s=tuple(found),
            cycles=len(found),
        )
        for number, (key, found) in enumerate(windows.items(), 1)
    )
    return Program.model_validate({"schema_": "lmeasure.program/1", "name": f"rests of {drawn.name}", "pose": own})


def _home(drawn: AnyRobot) -> FloatArray:
    """Return the (7,) default base_from_flange of the robot."""
    if isinstance(drawn, ParallelFile | PlatformFile):
        return drawn.model.home
    return np.asarray(drawn.model.forward(_rest(drawn)[None])[0])


def _rest(drawn: AnyRobot) -> FloatArray:
    """(n,) joint values at home; an arm's wrist is bent, so that it does not begin at a singular pose."""
    if isinstance(drawn, ParallelFile):
        return drawn.model.home_joints
    low, high = drawn.model.limits
    rest = np.clip(np.zeros(len(low)), low, high)
    rest[4:5] = np.clip(1.4, low[4:5], high[4:5])
    return rest


def _remarks(drawn: AnyRobot, nominal: Mounted, done: Performance, *, programmed: bool) -> tuple[str, ...]:
    """Return the notes that a person should know before believing such a robot."""
    ends = np.array([command.poses[-1] for command in done.commands])
    out = []
    if isinstance(drawn, ParallelFile):
        flange = nominal.flange(ends)
        attained = drawn.model.nearest(flange)
        kept = checked(drawn.model, drawn.limits, attained)
        beyond = [name for name in ("gaps", "base_cone", "platform_cone", "regular", "stands") if not getattr(kept, name).all()]
        if beyond:
            count = int((~kept.all).sum())
            out.append(message("iso9283.commanded_poses_lie_outside", count=count, all=len(ends), name=drawn.name, limits=tuple(beyond)))
        off = np.linalg.norm(nominal.placed(attained)[:, :3] - ends[:, :3], axis=1)
        if off.max() > 1e-6:
            out.append(message("iso9283.told_alone_others_follow", name=drawn.name, joints=tuple(drawn.model.commanded), mm=off.max()))
            if programmed:
                out.append(message("iso9283.told_waypoint_joint_values", name=drawn.name))
    return tuple(out)
