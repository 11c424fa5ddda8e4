from . import conventions as conventions
from . import se3 as se3
from .arrays import (
    BoolArray as BoolArray,
)
from .arrays import (
    ComplexArray as ComplexArray,
)
from .arrays import (
    FloatArray as FloatArray,
)
from .arrays import (
    IntArray as IntArray,
)
from .arrays import (
    TextArray as TextArray,
)
from .conventions import (
    CONVENTIONS as CONVENTIONS,
)
from .conventions import (
    LARGEST_ANGLE as LARGEST_ANGLE,
)
from .conventions import (
    MAX_LENGTH_MM as MAX_LENGTH_MM,
)
from .conventions import (
    QUATERNION_COLUMNS as QUATERNION_COLUMNS,
)
from .conventions import (
    TEMPERATURE_RANGE_C as TEMPERATURE_RANGE_C,
)
from .conventions import (
    AngleConvention as AngleConvention,
)
from .conventions import (
    angles_from_rotation as angles_from_rotation,
)
from .conventions import (
    check_angles as check_angles,
)
from .conventions import (
    convention as convention,
)
from .conventions import (
    rotation_from_angles as rotation_from_angles,
)
from .conventions import (
    rounded_angles as rounded_angles,
)
from .display import (
    DataFrame as DataFrame,
)
from .display import (
    Shown as Shown,
)
from .display import (
    framed as framed,
)
from .entry_points import (
    PlugInError as PlugInError,
)
from .entry_points import (
    check_kind as check_kind,
)
from .entry_points import (
    plug_in as plug_in,
)
from .entry_points import (
    plug_in_names as plug_in_names,
)
from .entry_points import (
    plug_in_of as plug_in_of,
)
from .entry_points import (
    plug_in_version as plug_in_version,
)
from .entry_points import (
    plug_ins as plug_ins,
)
from .entry_points import (
    plug_ins_in_use as plug_ins_in_use,
)
from .errors import (
    AccuracyError as AccuracyError,
)
from .errors import (
    AcquisitionError as AcquisitionError,
)
from .errors import (
    CalibrationError as CalibrationError,
)
from .errors import (
    CancelledError as CancelledError,
)
from .errors import (
    CertificationError as CertificationError,
)
from .errors import (
    FileFormatError as FileFormatError,
)
from .errors import (
    ForeignFolderError as ForeignFolderError,
)
from .errors import (
    GeometryError as GeometryError,
)
from .errors import (
    KeyKeptError as KeyKeptError,
)
from .errors import (
    LMeasureError as LMeasureError,
)
from .errors import (
    OtherTrajectoryError as OtherTrajectoryError,
)
from .errors import (
    OverwriteError as OverwriteError,
)
from .errors import (
    RecordedError as RecordedError,
)
from .errors import (
    RigError as RigError,
)
from .errors import (
    RobotError as RobotError,
)
from .errors import (
    SettingsError as SettingsError,
)
from .errors import (
    StructureError as StructureError,
)
from .errors import (
    TrajectoryError as TrajectoryError,
)
from .errors import (
    pasted as pasted,
)
from .errors import (
    shortened as shortened,
)
from .interpolation import (
    OtherTimes as OtherTimes,
)
from .interpolation import (
    lagrange as lagrange,
)
from .linalg import (
    covariance_root as covariance_root,
)
from .linalg import (
    symmetric_root as symmetric_root,
)
from .packages import (
    how_to_install as how_to_install,
)
from .packages import (
    version_of as version_of,
)
from .status import (
    WORDS as WORDS,
)
from .status import (
    Status as Status,
)
from .status import (
    words as words,
)
