"""A run as a whole: its passes brought together, reconstructed, and its uncertainties by the law that is asked for."""

from collections.abc import Callable
from dataclasses import replace

from lmeasure.recorded import notes_of
from lmeasure.run import Run
from lmeasure.trajectory.monte_carlo import by_monte_carlo
from lmeasure.trajectory.passes import Alignment, align
from lmeasure.trajectory.record import Trajectory
from lmeasure.trajectory.screw_method import Reconstruction


def reconstruct(
    run: Run | Alignment,
    constraint: str | None = None,
    repeatability_mm: float = 0.0,
    trials: int = 0,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    *,
    covariances: bool = True,
) -> Trajectory:
    """The trajectory of a run, its cables counted in one pass or several; a constraint replaces the rig's.

    repeatability_mm: standard deviation, per axis, of the place to which the robot brings the tool in repeated passes. trials: of Monte
    Carlo instead of the linear law for the uncertainties, 0 for none; see `monte_carlo.by_monte_carlo`. covariances: False leaves those
    of a single pass at zero, for a reader who works them out only where he needs them: who aligns the run (`passes.align`) and gives
    both of them that has its lengths worked out once.
    Raises what `Reconstruction` and `passes.align` raise.
    """
    aligned = align(run)
    run, lengths, clocks = aligned.run, aligned.lengths, aligned.u_time_s
    given = run.u_start, clocks, repeatability_mm, run.temperature_c
    reconstruction = Reconstruction(run.rig, run.known_start, run.calibration, constraint, *given)
    trajectory = reconstruction.add(lengths, covariances=covariances or run.rig.passes > 1 or trials > 0)
    if trials:
        trajectory = by_monte_carlo(reconstruction, lengths, trajectory, trials, seed, progress)
    notes = (*trajectory.notes, *notes_of(run.recorded), *aligned.notes)
    if run.rig.passes > 1 and repeatability_mm == 0.0:
        notes = (*notes, "the robot's repeatability between the passes is not in the uncertainties")
    return replace(trajectory, notes=notes)
