"""The stages of the pipeline for scripts: each takes files or objects, settings as an object or by keywords, and gives an object.

They write only the files that you name. Commands, with their pages and the rule against overwriting, are in `lmeasure.workflows.registry`.
"""

import math
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from lmeasure.core import AccuracyError, CertificationError, FloatArray, LMeasureError
from lmeasure.recording import Run, read_run, write_run
from lmeasure.rig import CalibrationRecord, Rig, read_linked_rig
from lmeasure.text import LANGUAGES, message

if TYPE_CHECKING:
    import xarray as xr
    from scipy.spatial.transform import Rotation

    from lmeasure.accuracy import Placed, Placement, Scan
    from lmeasure.calibration import Calibration, CalibrationSettings, Campaign, Plan, PlanSettings
    from lmeasure.certificate import Certificate, Verification
    from lmeasure.iso9283 import Campaign as TestCampaign, CertificationSettings, Evaluation
    from lmeasure.recording import Program
    from lmeasure.report import Figure
    from lmeasure.robots import RobotModel
    from lmeasure.simulation import Scenario, Simulated, SimulatedCampaign, SimulatedRun
    from lmeasure.structure import Described, Linkage, Workspace
    from lmeasure.text import Message
    from lmeasure.trajectory import Alignment, Curve, ErrorModel, Reconstruction, Trajectory

File = Path | str
Steps = Callable[[int, int], None]
"""Called with (done, total); CancelledError raised from it ends the work."""
Span = tuple[float, float, float] | FloatArray
"""Nodes along an axis [mm]: start, stop and step, both ends included, or an array of them."""
Given = TypeVar("Given")


def calibrate(
    campaign: "Campaign | SimulatedCampaign | Simulated | File",
    settings: "CalibrationSettings | None" = None,
    progress: Steps | None = None,
    **options: Any,
) -> "Calibration":
    """Find a rig's observation points from counts at reference poses.

    Parameters
    ----------
    campaign
        Calibration folder, campaign read by `read_campaign`, or the result of `simulate`.
    settings
        Settings of the calibration; by default `CalibrationSettings()`.
    progress
        Called with (done, total) while the solver works. A CancelledError raised from it stops the work.
    **options
        Fields of `CalibrationSettings` that replace those of `settings`.

    Returns
    -------
    Calibration
        The calibrated rig, its covariances, residuals and warnings. `refused` states why a rig must not be used, else it is None.

    Raises
    ------
    CalibrationError
        If the counts cannot belong to the rig. The message names pose, channel and limit.
    FileFormatError
        If a file of the folder cannot be read. The message names file, row and column.
    TypeError
        If an option does not exist.

    Examples
    --------
    `simulated` is made in the example of `simulate`.

    >>> calibration = lm.calibrate(simulated, solve=("position", "guide"))
    >>> calibration.record.rank, calibration.refused
    (30, None)
    """
    from lmeasure.calibration import (
        CalibrationSettings as calibration_CalibrationSettings,
        Campaign,
        calibrate as calibration_calibrate,
        read_campaign,
    )
    from lmeasure.simulation import Simulated, SimulatedCampaign as simulation_SimulatedCampaign, write_campaign

    if isinstance(campaign, Simulated):
        campaign = _there(campaign.campaign, "reference_poses")
    if isinstance(campaign, simulation_SimulatedCampaign):
        with tempfile.TemporaryDirectory() as folder:
            write_campaign(Path(folder), campaign)
            campaign = read_campaign(Path(folder))
    elif isinstance(campaign, Path | str):
        campaign = read_campaign(Path(campaign))
    elif not isinstance(campaign, Campaign):
        raise _wrong("campaign", campaign, "a calibration folder, a Campaign, or the result of `simulate`")
    return calibration_calibrate(campaign, _with("calibrate", settings or calibration_CalibrationSettings(), options), progress)


def reconstruct(
    run: "Run | Alignment | SimulatedRun | Simulated | File",
    constraint: str | None = None,
    repeatability_mm: float = 0.0,
    trials: int = 0,
    *,
    seed: int = 0,
    progress: Steps | None = None,
    rig: "Rig | Calibration | File | None" = None,
    covariances: bool = True,
) -> "Trajectory":
    """Compute the tool's trajectory from the counts of a run.

    Parameters
    ----------
    run
        Run folder, run read by `read_run` or `read_log`, or the result of `simulate`.
    constraint
        "planar" or "vertical-axis": motion that the mechanism allows. It replaces the rig's own constraint.
    repeatability_mm
        Standard deviation, per axis, of the positions to which the robot returns in repeated passes [mm].
    trials
        Number of Monte Carlo trials that replace the linear law of uncertainty; 0 for none.
    seed
        Seed of these trials.
    progress
        Called with (done, total).
    rig
        Rig, with its calibration, that replaces the run's own.
    covariances
        False skips the covariances of single-pass runs, which saves time.

    Returns
    -------
    Trajectory
        Pose, status and covariances of every sample [mm, rad], base frame. Samples without a pose are NaN and name the cause.

    Raises
    ------
    LMeasureError
        If the counts cannot determine the poses. The message names sample, cable and limit.

    Examples
    --------
    >>> trajectory = lm.reconstruct(simulated, rig=calibration)
    >>> trajectory.poses.shape, int(trajectory.status.max())
    ((58, 7), 0)
    """
    from lmeasure.trajectory import reconstruct as trajectory_reconstruct

    return trajectory_reconstruct(
        _run(run, rig), constraint, repeatability_mm, trials, seed=seed, progress=progress, covariances=covariances, judge=explained
    )


def reconstruct_curve(
    run: "Run | Alignment | SimulatedRun | Simulated | File",
    constraint: str | None = None,
    *,
    spacing_s: float | None = None,
    joints: File | None = None,
    robot: "RobotModel | File | None" = None,
    rig: "Rig | Calibration | File | None" = None,
) -> "tuple[Trajectory, Curve]":
    """Compute the tool's trajectory in continuous time: poses, velocities and accelerations at any time, with covariances.

    Parameters
    ----------
    run
        Run folder, run read by `read_run` or `read_log`, or the result of `simulate`; of one pass.
    constraint
        "planar" or "vertical-axis": motion that the mechanism allows. It replaces the rig's own constraint.
    spacing_s
        Interval of the curve's knots [s]; None: chosen from the readings.
    joints
        Joint log of the robot (time_s, joint_1_deg, ...), a prior of the curve's shape.
    robot
        Robot of the log: a name such as "ur5", a robot.toml, or a model.
    rig
        Rig, with its calibration, that replaces the run's own.

    Returns
    -------
    tuple[Trajectory, Curve]
        Trajectory at the samples, with short gaps bridged, and the curve.

    Raises
    ------
    LMeasureError
        If the counts cannot determine the poses or a curve, or the log shows another motion. The message names sample, cable and limit.

    Examples
    --------
    >>> trajectory, curve = lm.reconstruct_curve(simulated, rig=calibration)
    >>> trajectory.poses.shape, curve.at(0.1).rates.shape
    ((58, 7), (1, 4, 6))
    >>> trajectory, curve = lm.reconstruct_curve("run", joints="log.csv", robot="ur5")  # doctest: +SKIP
    """
    from lmeasure.trajectory import reconstruct_curve as trajectory_reconstruct_curve

    log = None
    if joints is not None or robot is not None:
        from lmeasure.robots import any_shipped, read_joint_log, read_robot

        if joints is None or robot is None:
            raise TypeError("joints and robot go together")
        if isinstance(robot, Path | str):
            robot = (read_robot(Path(robot)) if Path(robot).suffix else any_shipped(str(robot))).model
        log = read_joint_log(Path(joints), robot)
    return trajectory_reconstruct_curve(_run(run, rig), constraint, spacing_s=spacing_s, joints=log, judge=explained)


def explained(reconstruction: "Reconstruction") -> "tuple[Message, ...]":
    """`procedures.intermediate_check.explanation.explained`, which is loaded only where channels can contradict each other."""
    if reconstruction.redundancy is None:
        return ()
    from lmeasure.procedures import explained

    return explained(reconstruction)


def zone(
    rig: "Rig | Calibration | File",
    x: Span,
    y: Span,
    z: Span,
    *,
    tilt_rad: float = 0.0,
    tilt_steps: int = 3,
    rotations: "Rotation | None" = None,
    scan: "Scan | None" = None,
    progress: Steps | None = None,
    **options: Any,
) -> "xr.Dataset":
    """Map the accuracy of a rig over a box of tool positions.

    Parameters
    ----------
    rig
        rig.toml, rig or calibration. A linked calibration contributes its covariance.
    x, y, z
        Positions of the tool origin, base frame [mm]: (start, stop, step), or an array (n,) of nodes.
    tilt_rad
        Largest tilt about each axis that is tried at each node [rad].
    tilt_steps
        Number of tilts along each axis.
    rotations
        All orientations base_from_tool to try at each node, instead of the tilts.
    scan
        Settings of the scan; by default `Scan()`.
    progress
        Called with (done, total).
    **options
        Limits (`angle_deg`, `u95_mm`, `length_mm`, `wrap_deg`, `clearance_mm` ...) and fields of the scan.

    Returns
    -------
    xarray.Dataset
        Over x, y, z: `worst_pressure_angle_deg`, `u95_position_mm`, `in_zone` and others, each the worst over the orientations.

    Raises
    ------
    AccuracyError
        If a limit or a span makes no sense.

    Examples
    --------
    >>> zone = lm.zone(calibration, (-100, 100, 100), (-100, 100, 100), (0, 0, 1), u95_mm=0.1)
    >>> dict(zone.sizes)["x"], bool(zone.u95_position_mm.max() < 0.1)
    (3, True)
    """
    from lmeasure.accuracy import Limits, Scan, axis, map_zone, tilts

    used, record = _linked(rig)
    scan = scan or Scan()
    within = {f.name: options.pop(f.name) for f in fields(Limits) if f.name in options}
    scan = _with("zone", scan, options, *(f.name for f in fields(Limits)))
    scan = replace(scan, limits=replace(scan.limits, **within))
    for name, span in zip("xyz", (x, y, z), strict=True):
        if isinstance(span, tuple) and len(span) != 3:
            raise AccuracyError(message("error.needs_three_numbers_least", name=name, span=str(span)))
    nodes = [axis(*span) if isinstance(span, tuple) else np.asarray(span, dtype=np.float64) for span in (x, y, z)]
    turned = tilts(tilt_rad, tilt_steps) if rotations is None else rotations
    return map_zone(used, record, (nodes[0], nodes[1], nodes[2]), turned, scan=scan, progress=progress)


def place(
    rig: Rig | File, task: "Placement | File", seed: int = 0, progress: Steps | None = None, *, generations: int | None = None
) -> "Placed":
    """Find positions of observation and attachment points that suit a task best.

    Parameters
    ----------
    rig
        rig.toml or rig to start from.
    task
        placement.toml, or the result of `read_placement`: where the points may be and which poses the tool takes.
    seed
        Seed of the search.
    progress
        Called with (done, total).
    generations
        Number of generations of the search.

    Returns
    -------
    Placed
        The best rig that was found, with its figures before and after.

    Raises
    ------
    AccuracyError
        If no rig within the bounds measures the task.

    Examples
    --------
    >>> lm.place("rig.toml", "placement.toml", generations=20)  # doctest: +SKIP
    """
    from lmeasure.accuracy import GENERATIONS, place as placement_place, read_placement

    wanted = read_placement(Path(task)) if isinstance(task, Path | str) else task
    most = GENERATIONS if generations is None else generations
    return placement_place(_linked(rig)[0], wanted, seed, progress, generations=most)


def analyse_structure(
    links: "Linkage | Rig | File",
    pose: FloatArray | None = None,
    *,
    lengths_mm: Iterable[float] | None = None,
    to: FloatArray | None = None,
    workspace: "Workspace | None" = None,
    design: bool = False,
) -> "Described":
    """Analyse a mechanism of links before anything is built or measured.

    Parameters
    ----------
    links
        structure.toml, linkage, or rig, whose cables are the links.
    pose
        (7,) position [mm] and quaternion x, y, z, w of the platform.
    lengths_mm
        Link lengths [mm] for which all assembly modes are found.
    to
        (7,) second pose, to which the platform moves in a straight line.
    workspace
        Workspace around the pose whose boundary is found.
    design
        True finds limits of the lengths within which no pose is singular.

    Returns
    -------
    Described
        The linkage and its record: mobility, structure, singularity, assembly modes.

    Raises
    ------
    LMeasureError
        If the links make no structure, or the pose contradicts them.

    Examples
    --------
    >>> found = lm.analyse_structure(rig, np.array([0.0, 0, 0, 0, 0, 0, 1]))
    >>> found.record["links"]
    6
    """
    from lmeasure.structure import Described, described, linkage_of, read_linkage

    found = linkage_of(links) if isinstance(links, Rig) else read_linkage(Path(links)) if isinstance(links, Path | str) else links
    found = found if lengths_mm is None else found.with_lengths(tuple(lengths_mm), "lengths_mm")
    at, there = (None if p is None else np.asarray(p, dtype=np.float64) for p in (pose, to))
    return Described(found, described(found, at, to=there, workspace=workspace, design=design), at)


def plan_poses(
    rig: "Rig | File",
    settings: "PlanSettings | None" = None,
    recorded: "Campaign | File | None" = None,
    progress: Steps | None = None,
    *,
    poses: int = 12,
    box: Iterable[tuple[float, float]] | None = None,
    tilt_deg: float = 15.0,
    **options: Any,
) -> "Plan":
    """Choose the reference poses of a calibration.

    Parameters
    ----------
    rig
        rig.toml or rig to be calibrated.
    settings
        Settings of the plan. Without them, `poses` and `box` are used.
    recorded
        Campaign, or its folder, that already exists and is extended.
    progress
        Called with (done, total).
    poses
        Number of poses.
    box
        ((low, high), (low, high), (low, high)) of the tool origin along x, y, z [mm].
    tilt_deg
        Largest rotation of the tool about each axis [deg].
    **options
        Fields of the settings.

    Returns
    -------
    Plan
        The poses, and the uncertainty of lengths and parameters that each further pose leaves.

    Raises
    ------
    CalibrationError
        If no box is given, or no pose in it can be measured.

    Examples
    --------
    >>> plan = lm.plan_poses(rig, poses=8, box=[(-200, 200), (-200, 200), (-100, 100)])
    >>> len(plan.poses)
    8
    """
    from lmeasure.calibration import PlanSettings as planning_PlanSettings, Region, plan_poses as planning_plan_poses, read_campaign
    from lmeasure.core import CalibrationError

    if settings is None:
        if box is None:
            raise CalibrationError(message("error.box_say_where_the"))
        low, high = np.array(list(box), dtype=np.float64).T
        settings = planning_PlanSettings(poses, Region(low, high, math.radians(tilt_deg), np.array([0.0, 0.0, 0.0, 1.0])))
    if isinstance(recorded, Path | str):
        recorded = read_campaign(Path(recorded))
    return planning_plan_poses(_linked(rig)[0], _with("plan_poses", settings, options), recorded, progress)


def plan_program(
    low_mm: Iterable[float] | None = None, high_mm: Iterable[float] | None = None, *, zone: File | None = None, **tests: Any
) -> "TestCampaign":
    """Write an ISO 9283 test program for the largest cube in a box or in an accuracy zone.

    Parameters
    ----------
    low_mm, high_mm
        (3,) corners of the box, base frame [mm].
    zone
        Zone file whose largest cube is used instead of a box.
    **tests
        Fields of `iso9283.Tests`: tests, speeds, loads, cycles, dwell times.

    Returns
    -------
    iso9283.Campaign
        The cube, the robot's commands and `program`, which `evaluate` and `certify` take.

    Raises
    ------
    CertificationError
        If neither or both of box and zone are given, or the box holds no cube.

    Examples
    --------
    >>> planned = lm.plan_program([300, -200, 400], [700, 200, 800], tests=("pose",))
    >>> [pose.name for pose in planned.program.pose][:3]
    ['P1', 'P2', 'P3']
    """
    from lmeasure.iso9283 import Tests, campaign, cube_in_zone, largest_cube

    if (zone is None) == (low_mm is None or high_mm is None):
        raise CertificationError(message("error.give_the_box_by"))
    cube = largest_cube(list(low_mm or ()), list(high_mm or ())) if zone is None else cube_in_zone(Path(zone))
    return campaign(cube, _with("plan_program", Tests(), tests))


def simulate(scenario: "Scenario | Mapping[str, Any] | File | None" = None, *, rig: Rig | None = None, **options: Any) -> "Simulated":
    """Simulate the counts of an instrument, with the true poses beside them.

    Parameters
    ----------
    scenario
        scenario.toml or its content as a mapping.
    rig
        True rig, instead of the one that the scenario names. Without both, a cell is drawn from the seed.
    **options
        Keys of the scenario that replace its own.

    Returns
    -------
    Simulated
        `run` with counts and truth of a motion, `campaign` with counts at reference poses; each None if the scenario states no such part.

    Raises
    ------
    FileFormatError
        If the scenario is wrong. The message names file and key.

    Examples
    --------
    >>> simulated = lm.simulate(seed=1, rate_hz=50.0, waypoint=[{"position_mm": [100, 0, 0]}], reference_poses={"count": 12})
    >>> simulated
    <Simulated run: 58 samples over 1.14 s, campaign: 12 reference poses>
    """
    from lmeasure.simulation import Scenario, read_scenario, scenario_from_dict, simulate as simulation_simulate

    if isinstance(scenario, Path | str):
        requested, named = read_scenario(Path(scenario))
        requested = requested.model_copy(update=options)
    else:
        content = scenario.model_dump(by_alias=True) if isinstance(scenario, Scenario) else dict(scenario or {})
        requested, named = scenario_from_dict({"schema": "lmeasure.scenario/1"} | content | options)
    if requested.robot is not None:
        from lmeasure.iso9283 import simulate_robot

        folder = Path(scenario).parent if isinstance(scenario, Path | str) else Path()
        return simulate_robot(requested, rig or named, folder).simulated
    return simulation_simulate(requested, rig or named)


def read_log(
    logs: File | Iterable[File], rig: Rig | File, start: FloatArray | None = None, *, bus: str | None = None, progress: Steps | None = None
) -> Run:
    """Read CAN logs as a run, one log for each pass.

    Parameters
    ----------
    logs
        Log file or files.
    rig
        rig.toml or rig whose channels the log contains.
    start
        (7,) pose at which the counters were zeroed: position [mm] and quaternion x, y, z, w. Logs do not contain it.
    bus
        Name of the bus inside the log, if it has several.
    progress
        Called with (done, total).

    Returns
    -------
    Run
        Counts on the time base of the SYNC messages. The command `import` also reports the rest of the log.

    Raises
    ------
    AcquisitionError
        If the log contains no counts of a channel.
    FileFormatError
        If the file is no log.

    Examples
    --------
    >>> lm.read_log("drive.blf", "rig.toml")  # doctest: +SKIP
    """
    from lmeasure.acquisition import import_logs

    used, record = _linked(rig)
    paths = [Path(log) for log in ([logs] if isinstance(logs, Path | str) else logs)]
    folder = Path() if isinstance(rig, Rig) else Path(rig).parent
    return import_logs(paths, used, start, calibration=record, folder=folder, bus=bus, progress=progress).run


def evaluate(
    trajectory: "Trajectory | File",
    program: "Program | File",
    covariances: "ErrorModel | None" = None,
    *,
    run: "Run | SimulatedRun | Simulated | File | None" = None,
    rig: "Rig | Calibration | File | None" = None,
    settings: "CertificationSettings | None" = None,
    progress: Steps | None = None,
    **options: Any,
) -> "Evaluation":
    """Compute the ISO 9283 characteristics of a trajectory, each with U95 and a verdict.

    Parameters
    ----------
    trajectory
        Trajectory or file, of lmeasure or of another instrument.
    program
        program.toml or `Program`: commanded poses and paths with their time windows.
    covariances
        Covariances of the poses, as `covariances` returns them.
    run, rig
        Run, and rig, from which the trajectory was reconstructed. They supply the correlations of its errors.
    settings
        Settings of the evaluation; by default `CertificationSettings()`.
    progress
        Called with (done, total).
    **options
        Fields of `CertificationSettings`.

    Returns
    -------
    Evaluation
        All characteristics, the attained poses and paths, and the remarks.

    Raises
    ------
    CertificationError
        If a pose or path cannot be evaluated. The message names the window and sample.

    Examples
    --------
    >>> program = lm.Program(
    ...     schema="lmeasure.program/1",
    ...     pose=[{"name": "P1", "position_mm": (100, 0, 0), "quaternion_xyzw": (0, 0, 0, 1), "windows_s": [(1.0, 1.1)]}],
    ... )
    >>> figures = lm.evaluate(trajectory, program, run=simulated, rig=calibration)
    >>> figures.characteristics[0].name
    'AP_p'
    """
    from lmeasure.iso9283 import CertificationSettings as certification_CertificationSettings, evaluate as certification_evaluate
    from lmeasure.recording import read_program
    from lmeasure.trajectory import Stated, read_trajectory

    chosen = _with("evaluate", settings or certification_CertificationSettings(), options)
    reported = _read(program, read_program)
    poses = _read(trajectory, lambda path: read_trajectory(path, Stated(angles=chosen.angles, likely=reported.angles)))
    counted = None if run is None else _run(run, rig)
    return certification_evaluate(poses, reported, covariances, run=counted, settings=chosen, progress=progress)


def certify(
    trajectory: "Trajectory | File",
    program: "Program | File",
    out: File,
    *,
    run: "Run | SimulatedRun | Simulated | File | None" = None,
    rig: "Rig | Calibration | File | None" = None,
    details: File | None = None,
    language: str = "en",
    key: File | None = None,
    dcc: bool = False,
    force: bool = False,
    settings: "CertificationSettings | None" = None,
    progress: Steps | None = None,
    **options: Any,
) -> "Certificate":
    """Write the sealed folder of a certificate: results, page, PDF and copies of all inputs.

    Parameters
    ----------
    trajectory
        Trajectory or file.
    program
        program.toml or `Program`.
    out
        Folder to write.
    run, rig
        Run, and rig, from which the trajectory was reconstructed.
    details
        details.toml about laboratory, customer and robot.
    language
        "en" or "ru".
    key
        Private key file that signs the folder.
    dcc
        True also writes a digital calibration certificate.
    force
        True replaces an earlier certificate in `out`.
    settings
        Settings of the evaluation; by default `CertificationSettings()`.
    progress
        Called with (done, total).
    **options
        Fields of `CertificationSettings`.

    Returns
    -------
    Certificate
        The folder and the content of its certificate.json.

    Raises
    ------
    CertificationError
        If the inputs cannot be certified. Nothing is written then.

    Examples
    --------
    >>> certificate = lm.certify(trajectory, program, "certificate", run=simulated, rig=calibration)  # doctest: +SKIP
    """
    from lmeasure.certificate import Certificate, Inputs
    from lmeasure.iso9283 import CertificationSettings as certification_CertificationSettings
    from lmeasure.recording import write_program
    from lmeasure.report import Choices, write_certificate
    from lmeasure.trajectory import write_trajectory

    chosen = _with("certify", settings or certification_CertificationSettings(), options)
    if language not in LANGUAGES:
        raise CertificationError(message("error.language_must_be", language=language, languages=" or ".join(LANGUAGES)))
    choices = Choices(language, None if key is None else Path(key), dcc, force=force)
    with tempfile.TemporaryDirectory() as scratch:
        here = Path(scratch)
        counted: Path | None = None
        used: Path | None = None
        if isinstance(run, Path | str) and (rig is None or isinstance(rig, Path | str)):
            counted, used = Path(run), None if rig is None else Path(rig)
        elif run is not None:
            counted = _written(here / "run", _run(run, rig), write_run)
        inputs = Inputs(
            _written(here / "trajectory.parquet", trajectory, write_trajectory),
            _written(here / "program.toml", program, write_program),
            counted,
            used,
            None if details is None else Path(details),
        )
        content = write_certificate(Path(out), inputs, chosen, choices, progress=progress)
    return Certificate(Path(out), content)


def verify(certificate: "Certificate | File", public_key: File | None = None, progress: Steps | None = None) -> "Verification":
    """Check every file's hash and recompute every result of a certificate.

    Parameters
    ----------
    certificate
        Folder, or the result of `certify`.
    public_key
        Key file of the expected signature.
    progress
        Called with (done, total).

    Returns
    -------
    Verification
        `differences` is empty if everything agrees.

    Raises
    ------
    CertificationError
        If the folder is no certificate.

    Examples
    --------
    >>> lm.verify("certificate").differences  # doctest: +SKIP
    ()
    """
    from lmeasure.certificate import Certificate, read_public_key, verify
    from lmeasure.report import PRINTERS

    folder = certificate.folder if isinstance(certificate, Certificate) else Path(certificate)
    return verify(folder, None if public_key is None else read_public_key(Path(public_key)), PRINTERS, progress)


def plot(what: Any, rig: "Rig | Calibration | File | None" = None) -> "Figure":
    """Draw an object of lmeasure as a plotly figure.

    Parameters
    ----------
    what
        Rig, poses, counts, lengths, run, calibration, trajectory, zone or one of its variables, plan, placement, program, evaluation,
        certificate, identification, corrections, structure or its boundary.
    rig
        Rig to draw with a zone or a trajectory.

    Returns
    -------
    plotly.graph_objects.Figure
        Figure that can be shown, changed or written.

    Raises
    ------
    TypeError
        If nothing is drawn for such an object.

    Examples
    --------
    >>> len(lm.plot(trajectory, rig).data) > 0
    True
    """
    from lmeasure.report import figure_of

    return figure_of(what, None if rig is None else _linked(rig)[0])


def _linked(rig: "Rig | Calibration | File") -> tuple[Rig, CalibrationRecord | None]:
    """A rig and its calibration record, if it has one."""
    if isinstance(rig, Rig):
        return rig, None
    if isinstance(rig, Path | str):
        return read_linked_rig(Path(rig))
    from lmeasure.calibration import Calibration

    if not isinstance(rig, Calibration):
        raise _wrong("rig", rig, "a rig.toml, a Rig or a Calibration")
    return rig.rig, rig.record


def _run(run: "Run | Alignment | SimulatedRun | Simulated | File", rig: "Rig | Calibration | File | None") -> Any:
    """Return a run, a simulation's or an alignment's too, with the given rig in place of its own."""
    from lmeasure.simulation import Simulated, SimulatedRun
    from lmeasure.trajectory import Alignment

    found = read_run(Path(run)) if isinstance(run, Path | str) else run
    if isinstance(found, Simulated):
        found = _there(found.run, "waypoint")
    if isinstance(found, SimulatedRun):
        found = found.run
    if not isinstance(found, Run | Alignment):
        raise _wrong("run", found, "a run folder, a Run, or the result of `simulate`")
    if rig is None:
        return found
    used, record = _linked(rig)
    return replace(found if isinstance(found, Run) else found.run, rig=used, calibration=record)


def _with(stage: str, settings: Given, options: Mapping[str, Any], *others: str) -> Given:
    """Settings with these fields; TypeError names one that there is not, as for any function. others: options beside them."""
    known = [f.name for f in fields(settings)]  # type: ignore[arg-type]
    for name in options:
        if name not in known:
            raise TypeError(f"{stage}() has no option {name!r}; options: {', '.join([*others, *known])}")
    return replace(settings, **options)  # type: ignore[type-var]


def _wrong(name: str, given: object, wanted: str) -> TypeError:
    return TypeError(f"{name} must be {wanted}, not {type(given).__name__}")


def _there(part: Given | None, key: str) -> Given:
    """Return a part of a simulation."""
    if part is None:
        raise LMeasureError(message("error.the_scenario_states_no", key=key))
    return part


def _read(given: Given | File, read: Callable[[Path], Given]) -> Given:
    return read(Path(given)) if isinstance(given, Path | str) else given


def _written(path: Path, given: Given | File, write: Callable[[Path, Given], None]) -> Path:
    """Return the path of the file of an object, which is written if it is no path."""
    if isinstance(given, Path | str):
        return Path(given)
    write(path, given)
    return path
