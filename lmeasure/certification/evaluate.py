"""From a trajectory and the program it ran to the characteristics of ISO 9283."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmeasure.certification.attained import AttainedPose, attained_poses
from lmeasure.certification.characteristic import Characteristic, Rule
from lmeasure.certification.errors_of_poses import ErrorModel, ErrorsOfFile, ErrorsOfRun
from lmeasure.certification.iso9283_pose import pose_accuracy, pose_accuracy_components, pose_repeatability
from lmeasure.program import Program
from lmeasure.run import Run, RunHead
from lmeasure.trajectory import Trajectory

FloatArray = NDArray[np.float64]

SCHEMA = "lmeasure.certificate/1"


@dataclass(frozen=True)
class Settings:
    """What of an evaluation can be chosen; all of it belongs in the certificate.

    align: fit the base frame to the poses before anything else; tool_offset_mm: the point of the tool that is certified, in the tool frame;
    capability: largest u95 as a fraction of the characteristic; limit_angle_deg, limit_u95_mm: of the instrument's zone, None for no limit;
    rule: of decision on tolerances; planes: normal to a path; still_mm: largest motion within a window; trials, seed: of Monte Carlo.
    """

    align: bool = False
    tool_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    capability: float = 0.25
    limit_angle_deg: float | None = 60.0
    limit_u95_mm: float | None = None
    rule: Rule = "simple"
    planes: int = 100
    still_mm: float = 0.2
    trials: int = 4000
    seed: int = 0

    def as_dict(self) -> dict[str, Any]:
        """For certificate.json."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in vars(self).items() if v is not None}


@dataclass(frozen=True)
class Excluded:
    """A part of the program that gets no verdict, and why."""

    kind: str
    name: str
    reason: str


@dataclass(frozen=True)
class AttainedPath:
    """How a path was run: commanded (m, 3) points [mm] at arc (m,) [mm], where the planes stand; attained (n, m, 3) crossings
    [mm] of n cycles, deviation (n, m) their distance from the commanded points, speed (n, m - 1) between the planes [mm/s]."""

    name: str
    arc_mm: FloatArray
    commanded: FloatArray
    attained: FloatArray
    deviation_mm: FloatArray
    speed_mm_s: FloatArray
    commanded_speed_mm_s: float | None
    excluded: str | None = None


@dataclass(frozen=True)
class Evaluation:
    """The characteristics, and what stands behind them.

    excluded: parts outside the zone. poses: commanded and attained poses in the base frame (after an alignment, in the
    program's); paths: likewise. base_from_program (7,): the fitted frame, None when not asked for. angles: convention of component-wise
    angles. covers: what the uncertainties hold, in words. notes: for the reader.
    """

    characteristics: tuple[Characteristic, ...]
    excluded: tuple[Excluded, ...]
    poses: tuple[AttainedPose, ...]
    paths: tuple[AttainedPath, ...]
    base_from_program: FloatArray | None
    angles: str
    covers: str
    settings: Settings
    notes: tuple[str, ...] = field(default=())


def evaluate(
    trajectory: Trajectory,
    program: Program,
    covariances: ErrorModel | None = None,
    *,
    run: Run | RunHead | None = None,
    settings: Settings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """The characteristics that the program's poses and paths allow, each with U95 and a verdict.

    covariances: where the errors of poses come from; by default the run's rig and calibration, or without a run the uncertainties of
    the trajectory, whose common part is not known and is therefore taken as whatever is worse for each figure.
    CertificationError names the window and sample when a pose or path cannot be told.
    """
    settings = settings or Settings()
    models: tuple[ErrorModel, ...]
    if covariances is not None:
        models = (covariances,)
    elif run is not None:
        models = (ErrorsOfRun(run),)
    else:
        models = (ErrorsOfFile(True), ErrorsOfFile(False))
    poses = attained_poses(trajectory, program, settings.still_mm)
    out: list[Characteristic] = []
    for pose in poses:
        n, commanded = len(pose.poses), pose.commanded[:3]
        errors = [m.at(trajectory, pose.samples, pose.poses) for m in models]
        u = [
            np.array(
                [
                    np.trace(
                        (e.random / n + np.einsum("nik,njk->nij", e.own, e.own) + np.einsum("nik,njk->nij", e.shared, e.shared))[0][3:, 3:]
                    )
                ]
            )
            for e in errors
        ]
        u95 = 1.96 * float(np.sqrt(max(x.max() for x in u) / 3.0))
        positions = pose.poses[:, :3]
        figures = [("AP_p", float(pose_accuracy(positions, commanded)))]
        figures += list(zip(("AP_x", "AP_y", "AP_z"), map(float, pose_accuracy_components(positions, commanded)), strict=True))
        if n > 1:
            figures.append(("RP_l", float(pose_repeatability(positions))))
        for name, value in figures:
            out.append(
                Characteristic(
                    name=name,
                    clause="7.2.2" if name == "RP_l" else "7.2.1",
                    value=value,
                    unit="mm",
                    u95=u95,
                    capable=u95 <= settings.capability * abs(value),
                    cycles=n,
                    pose=pose.name,
                    limit_u95=settings.capability * abs(value),
                )
            )
    return Evaluation(tuple(out), (), poses, (), None, program.angles or "fanuc-wpr", models[0].covers, settings)
