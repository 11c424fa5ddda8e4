from .calibration_record import (
    CalibrationRecord as CalibrationRecord,
)
from .calibration_record import (
    Dimension as Dimension,
)
from .calibration_record import (
    Finding as Finding,
)
from .calibration_record import (
    Input as Input,
)
from .calibration_record import (
    RecordedParameter as RecordedParameter,
)
from .calibration_record import (
    Residual as Residual,
)
from .calibration_record import (
    ShownEffect as ShownEffect,
)
from .calibration_record import (
    SolvedEffect as SolvedEffect,
)
from .calibration_record import (
    Unobservable as Unobservable,
)
from .calibration_record import (
    read_calibration_record as read_calibration_record,
)
from .calibration_record import (
    write_calibration_record as write_calibration_record,
)
from .can import (
    SYNC_ID as SYNC_ID,
)
from .can import (
    CanOpenCan as CanOpenCan,
)
from .can import (
    CounterChannel as CounterChannel,
)
from .can import (
    DbcCan as DbcCan,
)
from .can import (
    DbcChannel as DbcChannel,
)
from .can import (
    J1939Can as J1939Can,
)
from .can import (
    J1939Channel as J1939Channel,
)
from .can import (
    NodeChannel as NodeChannel,
)
from .can import (
    RawCan as RawCan,
)
from .can import (
    StartInput as StartInput,
)
from .can import (
    default_can as default_can,
)
from .drum_measurement import (
    DrumMeasurement as DrumMeasurement,
)
from .drum_measurement import (
    DrumsFile as DrumsFile,
)
from .drum_measurement import (
    choose as choose,
)
from .drum_measurement import (
    drum_geometry as drum_geometry,
)
from .drum_measurement import (
    drum_summary as drum_summary,
)
from .drum_measurement import (
    drums_into as drums_into,
)
from .drum_measurement import (
    read_drums as read_drums,
)
from .drum_measurement import (
    with_drums as with_drums,
)
from .encoders import (
    AngleEncoder as AngleEncoder,
)
from .encoders import (
    Inclination as Inclination,
)
from .encoders import (
    Swivel as Swivel,
)
from .parameter_table import (
    FURTHER as FURTHER,
)
from .parameter_table import (
    TABLE as TABLE,
)
from .parameter_table import (
    TILT as TILT,
)
from .parameter_table import (
    Owner as Owner,
)
from .parameters import (
    ENCODER_ZERO as ENCODER_ZERO,
)
from .parameters import (
    FACTORS as FACTORS,
)
from .parameters import (
    FURTHER_KEYS as FURTHER_KEYS,
)
from .parameters import (
    GROUPS as GROUPS,
)
from .parameters import (
    GUIDE as GUIDE,
)
from .parameters import (
    PHASED as PHASED,
)
from .parameters import (
    PLACE as PLACE,
)
from .parameters import (
    SCALE as SCALE,
)
from .parameters import (
    UNSIGNED as UNSIGNED,
)
from .parameters import (
    Parameter as Parameter,
)
from .parameters import (
    Slots as Slots,
)
from .parameters import (
    attachment_names as attachment_names,
)
from .parameters import (
    azimuth_stretch as azimuth_stretch,
)
from .parameters import (
    further_names as further_names,
)
from .parameters import (
    group_names as group_names,
)
from .parameters import (
    kernel_values as kernel_values,
)
from .parameters import (
    parameter_names as parameter_names,
)
from .parameters import (
    parameter_of as parameter_of,
)
from .parameters import (
    solved_parameters as solved_parameters,
)
from .parameters import (
    tilt_names as tilt_names,
)
from .parameters import (
    value_of as value_of,
)
from .parameters import (
    with_kernel_values as with_kernel_values,
)
from .parameters import (
    with_values as with_values,
)
from .parameters import (
    zero_name as zero_name,
)
from .plausible_size import (
    unlikely_size as unlikely_size,
)
from .points_and_drums import (
    Cable as Cable,
)
from .points_and_drums import (
    Drum as Drum,
)
from .points_and_drums import (
    ObservationPoint as ObservationPoint,
)
from .record_link import (
    read_linked_rig as read_linked_rig,
)
from .rig import (
    CABLES_FOR_A_POSE as CABLES_FOR_A_POSE,
)
from .rig import (
    Observed as Observed,
)
from .rig import (
    Rig as Rig,
)
from .rig import (
    Turned as Turned,
)
from .rig import (
    read_rig as read_rig,
)
from .rig import (
    rig_from_dict as rig_from_dict,
)
from .rig import (
    write_rig as write_rig,
)
