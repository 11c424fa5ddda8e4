"""The stages of the pipeline for scripts: each takes files or objects, settings as an object or by keywords, and gives an object.

Nothing is written but what is asked for by name; commands, with their pages and the rule for what they may write over, are
`lmeasure.workflows.registry`.
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
from lmeasure.text import LANGUAGES

if TYPE_CHECKING:
    import xarray as xr
    from scipy.spatial.transform import Rotation

    from lmeasure.accuracy import Placed, Placement, Scan
    from lmeasure.calibration import Calibration, CalibrationSettings, Campaign, Plan, PlanSettings
    from lmeasure.certificate import Certificate, Verification
    from lmeasure.iso9283 import Campaign as TestCampaign, CertificationSettings, Evaluation
    from lmeasure.recording import Program
    from lmeasure.report import Figure
    from lmeasure.simulation import Scenario, Simulated, SimulatedCampaign, SimulatedRun
    from lmeasure.structure import Described, Linkage, Workspace
    from lmeasure.text import Finding
    from lmeasure.trajectory import Alignment, ErrorModel, Reconstruction, Trajectory

File = Path | str
Steps = Callable[[int, int], None]
"""Is told how much is done of how much; CancelledError raised from it ends the work."""
Span = tuple[float, float, float] | FloatArray
"""Nodes along an axis [mm]: start, stop and step, both ends included, or an array of them."""
Given = TypeVar("Given")


def calibrate(
    campaign: "Campaign | SimulatedCampaign | Simulated | File",
    settings: "CalibrationSettings | None" = None,
    progress: Steps | None = None,
    **options: Any,
) -> "Calibration":
    """Find the observation points of a calibration folder, a campaign that was read, or a simulated one.

    options: fields of `CalibrationSettings`, in place of those of the settings. Raises what `calibration.read_campaign` and
    `calibration.calibrate` raise; a rig that must not be used is `refused` in the result.
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
        raise _wrong("campaign", campaign, "a calibration folder, a Campaign, or what `simulate` gives")
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
    """The trajectory of a run folder or a run; rig, with its calibration, replaces the run's own. See `trajectory.reconstruct`."""
    from lmeasure.trajectory import reconstruct as trajectory_reconstruct

    return trajectory_reconstruct(
        _run(run, rig), constraint, repeatability_mm, trials, seed=seed, progress=progress, covariances=covariances, judge=explained
    )


def explained(reconstruction: "Reconstruction") -> "tuple[Finding, ...]":
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
    """The accuracy zone of a rig over a box, with the calibration that it links.

    x, y, z: where the tool origin may be, base frame [mm]: (least, greatest, step), or the nodes themselves, an array (n,). rotations: all
    orientations base_from_tool that are tried at each node, in place of tilts by up to tilt_rad about each axis. options: fields of
    `accuracy.limits.Limits` (`angle_deg=60`, `u95_mm=...`) and of `accuracy.zone.Scan`. See `accuracy.zone.map_zone`.
    """
    from lmeasure.accuracy import Limits, Scan, axis, map_zone, tilts

    used, record = _linked(rig)
    scan = scan or Scan()
    within = {f.name: options.pop(f.name) for f in fields(Limits) if f.name in options}
    scan = _with("zone", scan, options, *(f.name for f in fields(Limits)))
    scan = replace(scan, limits=replace(scan.limits, **within))
    for name, span in zip("xyz", (x, y, z), strict=True):
        if isinstance(span, tuple) and len(span) != 3:
            raise AccuracyError(f"{name} = {span}: needs three numbers, least, greatest and step [mm], or an array of the nodes")
    nodes = [axis(*span) if isinstance(span, tuple) else np.asarray(span, dtype=np.float64) for span in (x, y, z)]
    turned = tilts(tilt_rad, tilt_steps) if rotations is None else rotations
    return map_zone(used, record, (nodes[0], nodes[1], nodes[2]), turned, scan=scan, progress=progress)


def place(
    rig: Rig | File, task: "Placement | File", seed: int = 0, progress: Steps | None = None, *, generations: int | None = None
) -> "Placed":
    """Places for observation and attachment points that make the instrument best at a task. See `accuracy.placement.place`."""
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
    """What links make of a rig, or of a table of points and links, before anything is built or measured.

    pose (7,): position [mm] and quaternion x, y, z, w of the platform; to (7,): another, to which it goes straight; lengths_mm: of which
    all assemblies are found; workspace: boundary around the pose; design: limits of the lengths within which nothing is singular. See
    `structure.record.described`.
    """
    from lmeasure.structure import linkage_of, read_linkage, structure_of

    found = linkage_of(links) if isinstance(links, Rig) else read_linkage(Path(links)) if isinstance(links, Path | str) else links
    found = found if lengths_mm is None else found.with_lengths(tuple(lengths_mm), "lengths_mm")
    return structure_of(found, pose, to=to, workspace=workspace, design=design)


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
    """Which reference poses to measure: settings, or poses, the box [mm] (low and high along x, y, z) in which the tool may be turned by
    tilt_deg about each axis, and other fields of `calibration.planning.Settings`. See `calibration.plan.pose_choice.plan_poses`."""
    from lmeasure.calibration import PlanSettings as planning_PlanSettings, Region, plan_poses as planning_plan_poses, read_campaign
    from lmeasure.core import CalibrationError

    if settings is None:
        if box is None:
            raise CalibrationError("box: say where the robot may go, low and high along x, y, z")
        low, high = np.array(list(box), dtype=np.float64).T
        settings = planning_PlanSettings(poses, Region(low, high, math.radians(tilt_deg), np.array([0.0, 0.0, 0.0, 1.0])))
    if isinstance(recorded, Path | str):
        recorded = read_campaign(Path(recorded))
    return planning_plan_poses(_linked(rig)[0], _with("plan_poses", settings, options), recorded, progress)


def plan_program(
    low_mm: Iterable[float] | None = None, high_mm: Iterable[float] | None = None, *, zone: File | None = None, **tests: Any
) -> "TestCampaign":
    """The test program of ISO 9283 for the largest cube in a box or in a zone file, with its commands.

    tests: fields of `iso9283.program.campaign.Tests`. Its `program` is what `evaluate` and `certify` take; it gets its windows from the
    trajectory's rests, or from `iso9283.ran`.
    """
    from lmeasure.iso9283 import Tests, campaign, cube_in_zone, largest_cube

    if (zone is None) == (low_mm is None or high_mm is None):
        raise CertificationError("give the box by low_mm and high_mm, or a zone")
    cube = largest_cube(list(low_mm or ()), list(high_mm or ())) if zone is None else cube_in_zone(Path(zone))
    return campaign(cube, _with("plan_program", Tests(), tests))


def simulate(scenario: "Scenario | Mapping[str, Any] | File | None" = None, *, rig: Rig | None = None, **options: Any) -> "Simulated":
    """Counts of an instrument along a motion and at reference poses, with the truth beside them.

    scenario: a scenario.toml, or its content; options: keys of it (`seed=1`, `waypoint=[...]`, `reference_poses={"count": 14}`). rig: the
    true rig, in place of the one that the scenario names.
    """
    from lmeasure.simulation import Scenario, read_scenario, scenario_from_dict, simulate as simulation_simulate

    if isinstance(scenario, Path | str):
        asked, named = read_scenario(Path(scenario))
        asked = asked.model_copy(update=options)
    else:
        content = scenario.model_dump(by_alias=True) if isinstance(scenario, Scenario) else dict(scenario or {})
        asked, named = scenario_from_dict({"schema": "lmeasure.scenario/1"} | content | options)
    if asked.robot is not None:
        from lmeasure.iso9283 import simulate_robot

        folder = Path(scenario).parent if isinstance(scenario, Path | str) else Path()
        return simulate_robot(asked, rig or named, folder).simulated
    return simulation_simulate(asked, rig or named)


def read_log(
    logs: File | Iterable[File], rig: Rig | File, start: FloatArray | None = None, *, bus: str | None = None, progress: Steps | None = None
) -> Run:
    """Log files of CAN frames as a run, one for each pass. start (7,): pose at which the counters were zeroed, which stands in no log.

    See `acquisition.logs.import_log.import_logs`; `lmeasure import` reports what else the logs contain.
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
    """The characteristics of ISO 9283 of a program in a trajectory, each with U95 and a verdict.

    run, rig: what the trajectory was reconstructed from, for the correlations of its errors; covariances: another model of them. options:
    fields of `CertificationSettings`. See `iso9283.evaluation`.
    """
    from lmeasure.iso9283 import CertificationSettings as certification_CertificationSettings, evaluate as certification_evaluate
    from lmeasure.recording import read_program
    from lmeasure.trajectory import Stated, read_trajectory

    chosen = _with("evaluate", settings or certification_CertificationSettings(), options)
    told = _read(program, read_program)
    poses = _read(trajectory, lambda path: read_trajectory(path, Stated(angles=chosen.angles, likely=told.angles)))
    counted = None if run is None else _run(run, rig)
    return certification_evaluate(poses, told, covariances, run=counted, settings=chosen, progress=progress)


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
    """Write the sealed folder of a certificate: figures, page, PDF and copies of all inputs, objects as the files that hold them.

    run, rig: what the trajectory was reconstructed from, rig if not the run's own; details: of laboratory, customer and item; language: en
    or ru; key: private key that signs; dcc: a digital calibration certificate too; force: replace an earlier certificate in `out`. options:
    fields of `CertificationSettings`. See `report.certificate.write_certificate`.
    """
    from lmeasure.certificate import Certificate, Inputs
    from lmeasure.iso9283 import CertificationSettings as certification_CertificationSettings
    from lmeasure.recording import write_program
    from lmeasure.report import Choices, write_certificate
    from lmeasure.trajectory import write_trajectory

    chosen = _with("certify", settings or certification_CertificationSettings(), options)
    if language not in LANGUAGES:
        raise CertificationError(f"language = {language!r}: must be {' or '.join(LANGUAGES)}")
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
    """Look at every byte of a certificate's folder and compute every figure again; public_key: whose signature it must bear."""
    from lmeasure.certificate import Certificate, read_public_key, verify
    from lmeasure.report import PRINTERS

    folder = certificate.folder if isinstance(certificate, Certificate) else Path(certificate)
    return verify(folder, None if public_key is None else read_public_key(Path(public_key)), PRINTERS, progress)


def plot(what: Any, rig: "Rig | Calibration | File | None" = None) -> "Figure":
    """A plotly figure of a rig, poses, counts, lengths, a run, a calibration, a trajectory, a zone, a plan, a placement, a program, an
    evaluation, a certificate, an identification, corrections, a structure or its boundary. rig: drawn with a zone or a trajectory."""
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
    """A run, that of a simulation, or what was aligned of one; with the rig in place of its own, if one is given."""
    from lmeasure.simulation import Simulated, SimulatedRun
    from lmeasure.trajectory import Alignment

    found = read_run(Path(run)) if isinstance(run, Path | str) else run
    if isinstance(found, Simulated):
        found = _there(found.run, "waypoint")
    if isinstance(found, SimulatedRun):
        found = found.run
    if not isinstance(found, Run | Alignment):
        raise _wrong("run", found, "a run folder, a Run, or what `simulate` gives")
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
    return TypeError(f"{name} is {type(given).__name__}; wanted is {wanted}")


def _there(part: Given | None, key: str) -> Given:
    """A part of what was simulated."""
    if part is None:
        raise LMeasureError(f"the scenario states no {key}: that part was not simulated")
    return part


def _read(given: Given | File, read: Callable[[Path], Given]) -> Given:
    return read(Path(given)) if isinstance(given, Path | str) else given


def _written(path: Path, given: Given | File, write: Callable[[Path, Given], None]) -> Path:
    """The path of what is in a file, or of the file that an object is written to."""
    if isinstance(given, Path | str):
        return Path(given)
    write(path, given)
    return path
