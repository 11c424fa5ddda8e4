"""The calibration record: values, uncertainties, undetermined combinations, and the source files."""

import json
import math
from collections import Counter
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, WrapValidator, model_validator

from lmeasure.core import DataFrame, FileFormatError, FloatArray, RigError, Shown, framed
from lmeasure.io import complaints, files, inside, of_key, reported
from lmeasure.rig.parameters import GUIDE, UNSIGNED, same_direction, value_of
from lmeasure.rig.rig import Rig, read_rig
from lmeasure.text import Message, message, restored, table

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Count = Annotated[int, Field(strict=True, ge=0)]
Text = Annotated[str, WrapValidator(lambda value, own: value if isinstance(value, Message) else own(value))]
"""A message, or the text of a file."""

# of the correlations: rounding of a covariance that is singular along a direction
NEGATIVE_EIGENVALUE = 1e-6


class _Record(BaseModel):
    """Part of a calibration record."""

    model_config = ConfigDict(extra="allow", frozen=True, populate_by_name=True, defer_build=True)


class RecordedParameter(_Record):
    """Estimated value in the unit of its name, with its standard uncertainty u and that of the nominal value, prior_u."""

    name: str
    value: Number
    u: Number
    prior_u: Number
    U95: float | None = None
    """Expanded uncertainty: half width of the 95 % interval of this value alone."""


class Residual(_Record):
    """Length residual of one channel at one pose: measured minus modelled [mm]."""

    pose: str
    channel: str
    mm: Number


class Unobservable(_Record):
    """Undetermined parameter combination: unit vector over a point's parameters, in units of their prior widths."""

    point: str
    direction: dict[str, Number]
    text: Text


class Dimension(_Record):
    """Uncertain dimension that was not estimated: corrected value with its standard uncertainty u, and prior_u before.
    covariance: with the p parameters, then with the s dimensions, in the units of their names."""

    name: str
    value: Number
    u: Annotated[Number, Field(ge=0)]
    prior_u: Annotated[Number, Field(ge=0)]
    covariance: tuple[Number, ...]


class SolvedEffect(_Record):
    """Estimated effect of an observation point (owner), by its name in `--solve`. value: difference from the rig's value, with u in unit;
    probability: of such a value by chance; bits: information gained; found: probability times the number of effects is below 0.01."""

    owner: str
    effect: str
    value: Number
    u: Annotated[Number, Field(ge=0)]
    unit: str
    probability: Number
    bits: Number
    found: bool


class ShownEffect(_Record):
    """Effect of a channel, searched for in the residuals, and the size that is detected with a probability of 80 %."""

    effect: Text
    channel: str
    size: Annotated[Number, Field(gt=0)]
    unit: str


class Finding(_Record):
    """Finding for the user, with a code from a fixed list and a text of one line."""

    code: str
    text: Text
    channel: str | None = None
    pose: str | None = None
    value: float | None = None


class Input(_Record):
    """Input file of the record."""

    file: str
    sha256: str


class CalibrationRecord(Shown, _Record):
    """Calibration record, the content of calibration.json: p parameters with their covariance, residuals, findings.

    Examples
    --------
    >>> record = calibration.record
    >>> record.rank, record.parameters[0].name
    (30, 'B1.x_mm')
    """

    schema_: Annotated[Literal["lmeasure.calibration/1"], Field(alias="schema")] = "lmeasure.calibration/1"
    """Kind and version of the file."""
    rig: str
    """Name of the rig."""
    parameters: tuple[RecordedParameter, ...]
    """Estimated values in the units of their names, with standard uncertainties."""
    covariance: tuple[tuple[Number, ...], ...]
    """(p, p) covariance of the parameters, in their order and units."""
    residuals: tuple[Residual, ...]
    """Length residual of each pose and channel [mm]."""
    equations: Count
    """Number of equations."""
    unknowns: Count
    """Number of unknowns."""
    rank: Count
    """Number of observable parameter combinations."""
    unobservable: tuple[Unobservable, ...] = ()
    """Parameter combinations that the data leave undetermined."""
    warnings: tuple[Finding, ...] = ()
    """Findings for the user."""
    inputs: tuple[Input, ...] = ()
    """Input files with their SHA-256 digests."""
    coarse: tuple[dict[str, Any], ...] = ()
    """Coarse solutions of each point."""
    ranges: tuple[dict[str, Any], ...] = ()
    """Ranges of points' positions over the priors of the assumed values."""
    correlations: tuple[dict[str, Any], ...] = ()
    """Pairs of parameters with a correlation of 0.95 or more."""
    spectrum: tuple[dict[str, Any], ...] = ()
    """Singular values of the fit with their parameter combinations."""
    poses: tuple[dict[str, Any], ...] = ()
    """Reference poses that were estimated with the rig, with their standard uncertainties."""
    predicted: dict[str, Any] = Field(default_factory=dict)
    """Predicted uncertainty of lengths and poses."""
    validation: dict[str, Any] = Field(default_factory=dict)
    """Results at validation poses and of cross-validation."""
    u_length_mm: dict[str, Number] = Field(default_factory=dict)
    """Standard uncertainty of a cable's length at each pose besides that of the parameters, by cable [mm]."""
    tangent_covariance: tuple[tuple[Number, ...], ...] | None = None
    """(p, p) covariance of the linearised model, for lengths and poses; None: `covariance` serves both."""
    region: dict[str, Any] = Field(default_factory=dict)
    """Confidence region of the parameters v: (v - values)' covariance^-1 (v - values) <= factor^2, with its probability."""
    robust: dict[str, Any] = Field(default_factory=dict)
    """Weights of poses in a robust fit."""
    noise: dict[str, float] = Field(default_factory=dict)
    """Chi-squared, degrees of freedom and rms residual of the fit."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """Settings of the calibration."""
    dimensions: tuple[Dimension, ...] = ()
    """Dimensions that were not estimated. Their uncertainty is included in that of the parameters."""
    effects: tuple[SolvedEffect, ...] = ()
    """Physical effects that were estimated, with their significance."""
    effects_shown: tuple[ShownEffect, ...] = ()
    """Physical effects that were searched for in the residuals."""
    temperature_c: Number | None = None
    """Mean temperature of the counts [°C]; None: not stated."""
    zero_length_mm: dict[str, Number] = Field(default_factory=dict)
    """Length of each cable where its counter was zeroed, by cable [mm]."""
    sizes: tuple[dict[str, Any], ...] = ()
    """Unstated sizes of errors, estimated from the residuals, in units of the typical ones."""
    messages: tuple[dict[str, Any], ...] = ()
    """Ids and values of the texts of this record (`lmeasure.text.table`)."""

    def about(self) -> dict[str, str]:
        """Return the solved parameters, the fit, the uncertainty of lengths, and remarks."""
        out = {"rig": self.rig, "parameters": f"{self.unknowns}, rank {self.rank}, from {self.equations} equations"}
        if "residual_rms_mm" in self.noise:
            out["residuals"] = f"{self.noise['residual_rms_mm']:.4g} mm rms"
        if self.predicted.get("lengths"):
            out["predicted u of lengths"] = f"{max(e['rms_mm'] for e in self.predicted['lengths']):.4f} mm rms"
        return out | {"warnings": ", ".join(dict.fromkeys(w.code for w in self.warnings)) or "none"}

    def to_frame(self) -> DataFrame:
        """A row for each parameter."""
        return framed([p.model_dump() for p in self.parameters])

    @model_validator(mode="after")
    def _are_covariances(self) -> Self:
        p = len(self.parameters)
        _check_covariance("covariance", self.covariance, p)
        if self.tangent_covariance is not None:
            _check_covariance("tangent_covariance", self.tangent_covariance, p)
        if p:
            name, times = Counter(q.name for q in self.parameters).most_common(1)[0]
            if times > 1:
                raise of_key("parameters", message("error.the_name_is_given", name=name, times=times))
        for own in self.dimensions:
            if len(own.covariance) != p + len(self.dimensions):
                numbers = {"n_covariance": len(own.covariance), "p": p + len(self.dimensions)}
                raise of_key("dimensions", message("error.covariance_has_numbers_not", name=own.name, **numbers))
        if self.dimensions:
            joint = self.joint_matrix()
            _check_covariance("dimensions: covariance", tuple(map(tuple, joint.tolist())), len(joint))
        return self

    def _of_dimensions(self) -> tuple[FloatArray, FloatArray]:
        """(p, s) covariance of the parameters with the dimensions, and (s, s) of these."""
        p = len(self.parameters)
        rows = np.array([own.covariance for own in self.dimensions], dtype=np.float64).reshape(-1, len(self.names)).T
        return rows[:p], rows[p:]

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of all determined parameters and dimensions."""
        return (*(p.name for p in self.parameters), *(d.name for d in self.dimensions))

    def covariance_matrix(self) -> FloatArray:
        """(p, p) covariance of the parameters in their own units."""
        return _matrix(self.covariance)

    def tangent_matrix(self) -> FloatArray:
        """(p, p) covariance of the parameters to propagate linearly, in their own units."""
        return _matrix(self.covariance if self.tangent_covariance is None else self.tangent_covariance)

    def joint_matrix(self) -> FloatArray:
        """(p + s, p + s) covariance of the parameters and, behind them, the dimensions, to propagate linearly, in their own units."""
        cross, own = self._of_dimensions()
        return np.block([[self.tangent_matrix(), cross], [cross.T, own]])

    def cable_covariance(self, names: list[list[str]]) -> FloatArray:
        """(13 m, 13 m) covariance of the kernels' parameters, mm and rad, for m cables.

        names[j] are the record's names of cable j's parameters in the kernels' order (`kernels.layout.PARAMETERS`).
        Parameters that were not solved are taken as exact.
        """
        select = self._selection(names)
        return np.asarray(select @ self.tangent_matrix() @ select.T)

    def dimension_columns(self, names: list[list[str]]) -> tuple[FloatArray, FloatArray]:
        """Return effects of independent errors of the dimensions, of unit variance: (s, s) on these, and (13 m, s) on the kernels'
        parameters, named as in `cable_covariance`, whose covariance contains the squares of these columns."""
        to_own, to_parameters = self._dimension_roots
        return to_own, self._selection(names) @ to_parameters

    @cached_property
    def _dimension_roots(self) -> tuple[FloatArray, FloatArray]:
        """Return (s, s) and (p, s) effects of independent errors of unit variance on the dimensions, and on the parameters."""
        cross, own = self._of_dimensions()
        width = np.sqrt(np.maximum(np.diag(own), 0.0))
        width = np.where(width > 0.0, width, 1.0)
        values, vectors = np.linalg.eigh(own / np.outer(width, width))
        kept = values > 1e-12
        root = np.where(kept, np.sqrt(np.maximum(values, 0.0)), 0.0)
        back = np.where(kept, 1.0 / np.where(kept, root, 1.0), 0.0)
        # symmetric, so that no choice of LAPACK's is in them (`lmeasure.core.linalg`)
        return width[:, None] * (vectors * root) @ vectors.T, (cross / width) @ (vectors * back) @ vectors.T

    def _selection(self, names: list[list[str]]) -> FloatArray:
        """(13 m, p) the kernels' parameters by the record's."""
        index = {p.name: i for i, p in enumerate(self.parameters)}
        flat = [name for row in names for name in row]
        select = np.zeros((len(flat), len(self.parameters)))
        for i, own in enumerate(flat):
            # the angle of a swivel axis is that of its guide plus its own tilt
            for name in dict.fromkeys((own, own.replace(".guide_", ".swivel_tilt_"))):
                if name in index:
                    select[i, index[name]] = math.radians(1.0) if name.endswith("_deg") else 1.0
        return select


def _matrix(rows: tuple[tuple[float, ...], ...]) -> FloatArray:
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(rows))


def _check_covariance(name: str, rows: tuple[tuple[float, ...], ...], p: int) -> None:
    """ValueError unless the rows are a symmetric positive semidefinite (p, p) matrix."""
    if len(rows) != p or any(len(row) != p for row in rows):
        raise of_key(name, message("error.is_not_x_as", p=p))
    matrix = _matrix(rows)
    scale = np.sqrt(np.outer(np.diag(matrix).clip(0), np.diag(matrix).clip(0)))
    if (np.diag(matrix) < 0).any() or (np.abs(matrix - matrix.T) > 1e-9 * scale + 1e-300).any():
        raise of_key(name, message("error.is_not_symmetric_with"))
    correlation = matrix / np.where(scale > 0, scale, 1.0)
    if p and np.linalg.eigvalsh(correlation).min() < -NEGATIVE_EIGENVALUE:
        raise of_key(name, message("error.is_not_positive_semidefinite"))


def read_calibration_record(path: Path) -> CalibrationRecord:
    """Read a calibration.json.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    CalibrationRecord
        Parameters, covariance, residuals and warnings.

    Raises
    ------
    FileFormatError
        If the file is wrong. The message names file and key.

    Examples
    --------
    >>> lm.write_calibration_record(Path("calibration.json"), calibration.record)
    >>> lm.read_calibration_record(Path("calibration.json")).rank
    30
    """
    raw = files.read_bytes(path)
    try:
        return _with_messages(CalibrationRecord.model_validate_json(raw))
    except ValidationError as error:
        # invalid JSON has no keys to name
        data = None if error.errors()[0]["type"] == "json_invalid" else json.loads(raw)
        raise reported(str(path), data, complaints(error, data, CalibrationRecord)) from None


def _with_messages(record: CalibrationRecord) -> CalibrationRecord:
    """Return a record that was read, whose texts are messages where it keeps their ids."""

    def known(rows: Any, key: str = "text") -> Any:
        return tuple(row.model_copy(update={key: restored(getattr(row, key), record.messages)}) for row in rows)

    texts = {"warnings": known(record.warnings), "unobservable": known(record.unobservable)}
    texts |= {"effects_shown": known(record.effects_shown, "effect"), "robust": restored(record.robust, record.messages)}
    return record.model_copy(update=texts | {"sizes": restored(record.sizes, record.messages), "messages": ()})


def _stated_messages(record: CalibrationRecord) -> list[dict[str, Any]]:
    own = [[w.text for w in record.warnings], [u.text for u in record.unobservable], [e.effect for e in record.effects_shown]]
    return table([*own, record.robust, record.sizes])


def write_calibration_record(path: Path, record: CalibrationRecord) -> None:
    """Write a calibration.json, complete or not at all.

    Parameters
    ----------
    path
        File to write.
    record
        Record of a calibration.

    Examples
    --------
    >>> lm.write_calibration_record(Path("calibration.json"), calibration.record)
    """
    content = record.model_dump(by_alias=True, mode="json") | {"messages": _stated_messages(record)}
    files.write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


ROUNDING = 1e-6  # Relative to a value, or to 1 if that is larger: rounding of a value with few digits
BESIDE_U = 0.01  # Relative to the value's standard uncertainty: negligible rounding


def read_linked_rig(path: Path) -> tuple[Rig, CalibrationRecord | None]:
    """A rig and the calibration record that its `calibration` key names, which must be there, in the rig's folder, and hold the
    values of this rig.

    FileFormatError names the parameter and both values where they differ.
    """
    rig = read_rig(path)
    if rig.calibration is None:
        return rig, None
    beside = inside(Path(path).parent, rig.calibration, f"{path}: calibration", "the rig's folder")
    record = read_calibration_record(beside)
    check_linked(rig, record, path, beside)
    return rig, record


def check_linked(rig: Rig, record: CalibrationRecord, rig_path: Path | str, record_path: Path | str) -> None:
    """FileFormatError when the record is of a rig of another name, or a parameter of its has another value there than the rig has. A radius
    has no sign, and guide angles that name one direction are the same. Parameters of kinds that a rig does not hold are passed over."""
    if record.rig != rig.name:
        raise FileFormatError(message("error.is_the_calibration_of", where=record_path, rig=record.rig, rig_path=rig_path, name=rig.name))
    values: list[RecordedParameter | Dimension] = [*record.parameters, *record.dimensions]
    for p in values:
        try:
            found = value_of(rig, p.name)
        except RigError as missing:
            raise FileFormatError(message("error.parameter", where=record_path, name=p.name, missing=missing, rig_path=rig_path)) from None
        if found is None:
            continue
        allowed = max(ROUNDING * max(1.0, abs(found)), BESIDE_U * abs(p.u))
        if not _apart(p.name.rpartition(".")[2], p.value, found) <= allowed:
            values_of = {"value": p.value, "rig_path": rig_path, "found": found}
            raise FileFormatError(message("error.parameter_but_has_it", where=record_path, name=p.name, **values_of))


def _apart(key: str, a: float, b: float) -> float:
    """Return how far two values of a parameter are apart."""
    if key in GUIDE:
        return min(abs(math.remainder(value - b, 360.0)) for value in same_direction(key, a))
    return abs(abs(a) - abs(b)) if key in UNSIGNED else abs(a - b)
