"""How cables' parameters err, in the kernels' order: what a calibration's record says, and the rig of its dimensions."""

import numpy as np

from lmeasure import unsolved
from lmeasure.arrays import FloatArray
from lmeasure.calibration_record import CalibrationRecord
from lmeasure.kernels.layout import PARAMETERS
from lmeasure.observation.cable_effects import DIMENSIONS
from lmeasure.observation.parameters import parameter_names
from lmeasure.rig import Cable, Drum, Observed, Rig


def cable_covariance(rig: Rig, record: CalibrationRecord | None, cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """(13 m, 13 m) covariance of the cables' parameters, mm and rad, in the kernels' order: of the record, and of dimensions that the rig
    states to be uncertain (`unsolved_columns`); zero where there is neither."""
    rest, columns = solved_covariance(rig, record, cables), unsolved_columns(rig, record, cables)
    return rest + columns @ columns.T if columns.shape[1] else rest


def solved_covariance(rig: Rig, record: CalibrationRecord | None, cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """(13 m, 13 m) covariance of the cables' parameters by what the calibration solved, without what they have from `unsolved_columns`."""
    m = len(rig.cable if cables is None else cables)
    if record is None:
        return np.zeros((m * len(PARAMETERS), m * len(PARAMETERS)))
    names = parameter_names(rig, cables)
    covariance = record.cable_covariance(names)
    if not record.dimensions:
        return covariance
    followed = record.dimension_columns(names)[1]
    return np.asarray(covariance - followed @ followed.T)


def unsolved_columns(rig: Rig, record: CalibrationRecord | None, cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """(13 m, s) errors of the cables' parameters, in the kernels' order, by independent variables of unit variance: of the dimensions that
    the rig states to be uncertain and the record has not solved, and of the parameters that a calibration fitted with them.

    What a record says of a dimension counts, and not the rig, whose statement was the calibration's prior.
    """
    chosen = rig.cable if cables is None else cables
    names = parameter_names(rig, chosen)
    known = () if record is None else record.dimensions
    solved = () if record is None else record.names
    drawn = tuple(c for c in chosen if isinstance(c, Cable))
    stated = {n: v.u for v in unsolved.stated(rig, drawn, solved, DIMENSIONS) for n in v.names}
    own = _selected(rig, chosen, tuple(stated)) * np.array(list(stated.values()))
    if record is None or not known:
        return own
    of_dimensions, followed = record.dimension_columns(names)
    return np.column_stack([_selected(rig, chosen, tuple(d.name for d in known)) @ of_dimensions + followed, own])


def _selected(rig: Rig, cables: tuple[Observed, ...], dimensions: tuple[str, ...]) -> FloatArray:
    """(13 m, s) the kernels' parameters by these dimensions of the rig."""
    names = parameter_names(rig, cables)
    out = np.zeros((len(cables), len(PARAMETERS), len(dimensions)))
    for j, c in enumerate(cables):
        drum = rig.counter(c)
        for s, name in enumerate(dimensions):
            if isinstance(drum, Drum) and name == f"{c.from_point}.count_length_mm":
                # a longer count is a recorded count that stands for more: f changes by k c/scale and by -k
                out[j, PARAMETERS.index("scale"), s] = -drum.scale / drum.count_length_mm
            elif name in names[j]:
                out[j, names[j].index(name), s] = 1.0
    return out.reshape(len(cables) * len(PARAMETERS), len(dimensions))
