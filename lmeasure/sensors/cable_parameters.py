"""Errors of cables' parameters, in the kernels' order: those of a calibration's record, and the rig of its dimensions."""

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.kernels import BY_AXIAL, PARAMETERS, length_gradients
from lmeasure.rig import FURTHER, FURTHER_KEYS, Cable, CalibrationRecord, Drum, Observed, Rig, SensorChannel, further_names, parameter_names
from lmeasure.sensors import stated_errors
from lmeasure.sensors.effect_laws import DIMENSIONS
from lmeasure.sensors.imperfect_parts import every_part
from lmeasure.sensors.stated_errors import SAME_MM


def further_solved(record: CalibrationRecord | None) -> bool:
    """Whether a calibration solved any of `parameters.FURTHER`, which the kernels do not know."""
    return record is not None and any(name.rpartition(".")[2] in FURTHER_KEYS for name in record.names)


def channel_names(rig: Rig, cables: tuple[Observed, ...] | None = None, *, wide: bool = False) -> list[list[str]]:
    """Return, for each channel, the record's names of the kernels' 13 parameters; wide: and of the 7 of `parameters.FURTHER` behind
    them."""
    names = parameter_names(rig, cables)
    return [own + more for own, more in zip(names, further_names(rig, cables), strict=True)] if wide else names


def width_of(*, wide: bool) -> int:
    """Return how many these are."""
    return len(PARAMETERS) + (len(FURTHER) if wide else 0)


def length_gradients_since(
    rig: Rig, cables: tuple[Cable, ...], zero: FloatArray, poses: FloatArray, *, counts: FloatArray, wide: bool = False
) -> FloatArray:
    """(n, m, 13) derivatives of the modelled less the measured changes of cables since a pose (7,) by their parameters, at (n, 7) poses and
    true counts (n, m); wide: as `channel_names` has it, (n, m, 20)."""
    rows, scales, m = rig.cable_rows(cables), rig.scales(cables), len(cables)
    begun = length_gradients(rows, np.array([zero]), np.zeros((1, m)), scales)
    out = length_gradients(rows, np.ascontiguousarray(poses), counts, scales) - begun
    if not wide:
        return np.asarray(out)
    of_parts = every_part(rig, cables).gradient(rows, (np.tile(zero, (m, 1)), np.zeros(m)), poses, counts)
    return np.concatenate([out, of_parts], axis=2)


def cable_covariance(
    rig: Rig, record: CalibrationRecord | None, cables: tuple[Observed, ...] | None = None, *, wide: bool = False
) -> FloatArray:
    """(13 m, 13 m) covariance of the cables' parameters, mm and rad, in the kernels' order: of the record, and of dimensions that the rig
    states to be uncertain (`unsolved_dimensions`); zero where there is neither. wide: as `channel_names` has it, 20 for each."""
    rest, columns = solved_covariance(rig, record, cables, wide=wide), unsolved_dimensions(rig, record, cables, wide=wide)[0]
    return rest + columns @ columns.T if columns.shape[1] else rest


def solved_covariance(
    rig: Rig, record: CalibrationRecord | None, cables: tuple[Observed, ...] | None = None, *, wide: bool = False
) -> FloatArray:
    """(13 m, 13 m) covariance of the cables' parameters by what the calibration solved, less what is of `unsolved_dimensions`."""
    m = len(rig.cable if cables is None else cables)
    if record is None:
        return np.zeros((m * width_of(wide=wide),) * 2)
    names = channel_names(rig, cables, wide=wide)
    covariance = record.cable_covariance(names)
    if not record.dimensions:
        return covariance
    followed = record.dimension_columns(names)[1]
    return np.asarray(covariance - followed @ followed.T)


def unsolved_dimensions(
    rig: Rig, record: CalibrationRecord | None, cables: tuple[Observed, ...] | None = None, *, wide: bool = False
) -> tuple[FloatArray, tuple[str, ...]]:
    """(13 m, s) errors of the cables' parameters, in the kernels' order, by independent variables of unit variance: of the dimensions that
    the rig states to be uncertain and the record has not solved, and of the parameters that a calibration fitted with them; (s,) which
    typical size each is, empty of what is stated or calibrated.

    What a record says of a dimension counts, and not the rig, whose statement was the calibration's prior.
    """
    chosen = rig.cable if cables is None else cables
    names = channel_names(rig, chosen, wide=wide)
    known = () if record is None else record.dimensions
    solved = () if record is None else record.names
    variables = stated_errors.stated(rig, chosen, solved, DIMENSIONS)
    stated = {n: v.u for v in variables for n in v.names}
    assumed = {n: v.typical for v in variables for n in v.names}
    # zeros of sensors are sources of their own, which a run may tell
    for sensor in {c.channel: c.table for c in chosen if isinstance(c, SensorChannel)}.values():
        own = {f"{sensor.channel}.{p.key}": sensor.u(p) * p.factor for p in sensor.solvable() if p.key != sensor.zero}
        stated |= {name: u for name, u in own.items() if u and name not in solved}
    zeroed = _zeroed_elsewhere(rig, record, chosen, len(names[0]))
    columns = np.column_stack([_selected(rig, chosen, names, tuple(stated)) * np.array(list(stated.values())), zeroed])
    keys = tuple(assumed.get(name, "") for name in stated) + ("zero_length_mm",) * zeroed.shape[1]
    if record is None or not known:
        return columns, keys
    of_dimensions, followed = record.dimension_columns(names)
    calibrated = _selected(rig, chosen, names, tuple(d.name for d in known)) @ of_dimensions + followed
    return np.column_stack([calibrated, columns]), ("",) * calibrated.shape[1] + keys


def _zeroed_elsewhere(rig: Rig, record: CalibrationRecord | None, cables: tuple[Observed, ...], width: int) -> FloatArray:
    """(13 m, s) errors of axial offsets, a variable for each drum whose counters were zeroed at other lengths than in the calibration.

    Nobody stated at which lengths the offsets hold. They are taken to hold where the counters are zeroed, as if the drum was turned back.
    The travel of a drum that was not is the standard uncertainty.
    """
    travel = {} if record is None or rig.unstated == "exact" else axial_travel(rig, record)
    drums = list(dict.fromkeys(c.from_point for c in cables if travel.get(c.name)))
    out = np.zeros((len(cables), width, len(drums)))
    for j, c in enumerate(cables):
        if travel.get(c.name):
            out[j, BY_AXIAL, drums.index(c.from_point)] = travel[c.name]
    return out.reshape(len(cables) * width, len(drums))


def axial_travel(rig: Rig, record: CalibrationRecord) -> dict[str, float]:
    """Travel [mm] of each cable's pay-out point from where the calibration zeroed its counter to where it was zeroed now, empty of cables
    that state `zero_length_mm` or were zeroed at the same length."""
    counts = rig.paid_out_since(record.zero_length_mm).tolist()
    every = [(c.name, k, rig.point(c.from_point).drum) for c, k in zip(rig.cable, counts, strict=True)]
    return {name: k * drum.axial_per_count_mm for name, k, drum in every if abs(k) * drum.per_count >= SAME_MM}


def _selected(rig: Rig, cables: tuple[Observed, ...], names: list[list[str]], dimensions: tuple[str, ...]) -> FloatArray:
    """(13 m, s) the kernels' parameters by these dimensions of the rig."""
    out = np.zeros((len(cables), len(names[0]), len(dimensions)))
    for j, c in enumerate(cables):
        drum = rig.counter(c)
        for s, name in enumerate(dimensions):
            if isinstance(drum, Drum) and name == f"{c.from_point}.count_length_mm":
                # a longer count is a recorded count that stands for more: f changes by k c/scale and by -k
                out[j, PARAMETERS.index("scale"), s] = -drum.scale / drum.count_length_mm
            elif name in names[j]:
                out[j, names[j].index(name), s] = 1.0
    return out.reshape(len(cables) * len(names[0]), len(dimensions))
