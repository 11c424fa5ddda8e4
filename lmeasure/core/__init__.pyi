from . import conventions as conventions, se3 as se3
from .arrays import (
    BoolArray as BoolArray,
    ComplexArray as ComplexArray,
    FloatArray as FloatArray,
    IntArray as IntArray,
    TextArray as TextArray,
    words_of as words_of,
)
from .conventions import (
    CONVENTIONS as CONVENTIONS,
    LARGEST_ANGLE as LARGEST_ANGLE,
    MAX_LENGTH_MM as MAX_LENGTH_MM,
    QUATERNION_COLUMNS as QUATERNION_COLUMNS,
    TEMPERATURE_RANGE_C as TEMPERATURE_RANGE_C,
    AngleConvention as AngleConvention,
    angles_from_rotation as angles_from_rotation,
    check_angles as check_angles,
    convention as convention,
    rotation_from_angles as rotation_from_angles,
    rounded_angles as rounded_angles,
)
from .display import DataFrame as DataFrame, Shown as Shown, framed as framed
from .entry_points import (
    PlugInError as PlugInError,
    check_kind as check_kind,
    how_to_install as how_to_install,
    plug_in as plug_in,
    plug_in_names as plug_in_names,
    plug_in_of as plug_in_of,
    plug_in_version as plug_in_version,
    plug_ins as plug_ins,
    plug_ins_in_use as plug_ins_in_use,
    version_of as version_of,
)
from .errors import (
    AccuracyError as AccuracyError,
    AcquisitionError as AcquisitionError,
    CalibrationError as CalibrationError,
    CancelledError as CancelledError,
    CertificationError as CertificationError,
    FileFormatError as FileFormatError,
    ForeignFolderError as ForeignFolderError,
    GeometryError as GeometryError,
    KeyKeptError as KeyKeptError,
    LMeasureError as LMeasureError,
    OtherTrajectoryError as OtherTrajectoryError,
    OverwriteError as OverwriteError,
    RecordedError as RecordedError,
    RigError as RigError,
    RobotError as RobotError,
    SettingsError as SettingsError,
    StructureError as StructureError,
    TrajectoryError as TrajectoryError,
    one_line as one_line,
    pasted as pasted,
    shortened as shortened,
)
from .interpolation import OtherTimes as OtherTimes, lagrange as lagrange
from .linalg import covariance_root as covariance_root, symmetric_root as symmetric_root
from .status import WORDS as WORDS, Status as Status, words as words
