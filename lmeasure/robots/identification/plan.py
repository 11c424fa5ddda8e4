"""Which poses of a robot to measure: those that leave the least uncertainty at the others.

A robot errs in more than the parameters that are freed: what its joints do besides, once and twice per turn, is there whether it is
identified or not. Poses that are best for the links alone gather where the links tell most and leave that unseen, which their residuals
then do not show and predictions elsewhere suffer from (Box and Draper, J. Am. Stat. Assoc. 54, 1959: designs against bias are spread wider
than those against variance). So poses are chosen for the links and harmonics together, each with its prior, whatever is freed afterwards.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.estimation import Criterion, Numbered, blocks, empty, grown, improved, ordered
from lmeasure.robots.identification.identify import freed
from lmeasure.robots.identification.initial_frames import Frames
from lmeasure.robots.identification.measurements import POSITION, measured
from lmeasure.robots.identification.unknowns import R, Unknowns

FAR_MM, FAR_RAD = 1e3, 1.0
"""Prior of frames of which nothing is known, while poses are chosen: as good as nothing, and the first poses are not lost in rounding."""
PLANNED_FOR = ("links", "once", "twice")
RANDOM = 20


@dataclass(frozen=True)
class Plan:
    """order (k,): chosen candidates, what brings most first; expected_mm, random_mm (k,): root mean square over the zone of what the
    identification leaves uncertain of a place after as many of them, and after as many at random, the median of `RANDOM` sets."""

    order: IntArray
    expected_mm: FloatArray
    random_mm: FloatArray


def to_plan(robot: R, families: Sequence[str], base: FloatArray, tool: FloatArray, *, joints: FloatArray) -> Unknowns[R]:
    """The unknowns of places to be measured at joint values, with what is planned for beside what is freed; base, tool (7,) as they are
    taken for."""
    rows = measured(joints, np.zeros((len(joints), 3)), side=np.zeros_like(joints))
    frames = Frames(base, tool[None], np.zeros((0, 3)), 0.0, np.ones(len(joints), np.bool_))
    return Unknowns(robot, freed(robot, (*PLANNED_FOR, *families)), frames, rows)


def chosen(unknowns: Unknowns[R], candidates: FloatArray, zone: FloatArray, count: int, *, u_mm: float) -> IntArray:
    """(count,) candidates (N, n) joint values that, measured with u_mm in each coordinate, leave the least mean variance of predicted
    places at the joint values `zone` (M, n) (I-optimality), in the order of what they bring."""
    return planned(unknowns, candidates, zone, count, u_mm=u_mm).order


def planned(unknowns: Unknowns[R], candidates: FloatArray, zone: FloatArray, count: int, *, u_mm: float, seed: int = 0) -> Plan:
    """`chosen` with what is expected of it."""
    determined = blocks(_sensitivity(unknowns, candidates), np.full(3, u_mm**2))
    criterion = Criterion("I", _sensitivity(unknowns, zone).reshape(-1, len(unknowns)))
    rng = np.random.default_rng(seed)
    width = np.minimum(unknowns.width, np.where(unknowns.size == 1.0, FAR_MM, FAR_RAD))
    start = empty(Numbered(determined), np.diag((unknowns.size / width) ** 2))
    design = ordered(improved(grown(start, count, criterion, rng), criterion, rng), criterion)

    def after(numbers: IntArray) -> FloatArray:
        """(k,) rms [mm] of a place's three coordinates together, after each of the poses."""
        M, out = start.before, []
        for i in numbers:
            M = M + determined[i].T @ determined[i]
            out.append(np.sqrt(3.0 * criterion.value(M)))
        return np.array(out)

    order = design.points[:, 0].astype(np.int64)
    random = [after(rng.permutation(len(determined))[: len(order)]) for _ in range(RANDOM)]
    return Plan(order, after(order), np.median(random, axis=0))


def _sensitivity(unknowns: Unknowns[R], joints: FloatArray) -> FloatArray:
    """(N, 3, p) derivatives of the first target's place by the unknowns in the units of their names."""
    rows = replace(measured(joints, np.zeros((len(joints), 3)), side=np.zeros_like(joints)), targets=unknowns.rows.targets)
    return unknowns.linearised(np.zeros(len(unknowns)), rows)[1][:, POSITION] * unknowns.size
