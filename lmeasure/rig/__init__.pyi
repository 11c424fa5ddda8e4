from .calibration_record import (
    CalibrationRecord as CalibrationRecord,
    Dimension as Dimension,
    Finding as Finding,
    Input as Input,
    RecordedParameter as RecordedParameter,
    Residual as Residual,
    ShownEffect as ShownEffect,
    SolvedEffect as SolvedEffect,
    Unobservable as Unobservable,
    read_calibration_record as read_calibration_record,
    write_calibration_record as write_calibration_record,
)
from .can import (
    SYNC_ID as SYNC_ID,
    CanOpenCan as CanOpenCan,
    CounterChannel as CounterChannel,
    DbcCan as DbcCan,
    DbcChannel as DbcChannel,
    J1939Can as J1939Can,
    J1939Channel as J1939Channel,
    NodeChannel as NodeChannel,
    RawCan as RawCan,
    StartInput as StartInput,
    default_can as default_can,
)
from .drum_measurement import (
    DrumMeasurement as DrumMeasurement,
    DrumsFile as DrumsFile,
    choose as choose,
    drum_geometry as drum_geometry,
    drum_summary as drum_summary,
    drums_into as drums_into,
    read_drums as read_drums,
    with_drums as with_drums,
)
from .parameter_table import FURTHER as FURTHER, TABLE as TABLE, TILT as TILT, Owner as Owner
from .parameters import (
    FACTORS as FACTORS,
    FURTHER_KEYS as FURTHER_KEYS,
    GROUPS as GROUPS,
    GUIDE as GUIDE,
    PHASED as PHASED,
    PLACE as PLACE,
    SCALE as SCALE,
    UNSIGNED as UNSIGNED,
    ZEROS as ZEROS,
    Parameter as Parameter,
    Slots as Slots,
    attachment_names as attachment_names,
    azimuth_stretch as azimuth_stretch,
    further_names as further_names,
    group_names as group_names,
    kernel_values as kernel_values,
    parameter_names as parameter_names,
    parameter_of as parameter_of,
    solved_parameters as solved_parameters,
    tilt_names as tilt_names,
    value_of as value_of,
    with_kernel_values as with_kernel_values,
    with_values as with_values,
)
from .plausible_size import unlikely_size as unlikely_size
from .points_and_drums import Cable as Cable, Drum as Drum, ObservationPoint as ObservationPoint
from .record_link import read_linked_rig as read_linked_rig
from .rig import (
    CABLES_FOR_A_POSE as CABLES_FOR_A_POSE,
    Observed as Observed,
    Rig as Rig,
    cables_among as cables_among,
    read_rig as read_rig,
    rig_from_dict as rig_from_dict,
    write_rig as write_rig,
)
from .sensor_table import (
    GROUP as GROUP,
    AngleSensor as AngleSensor,
    LengthSensor as LengthSensor,
    SensorChannel as SensorChannel,
    SensorTable as SensorTable,
    external_number as external_number,
    register_table as register_table,
    table_of as table_of,
)
from .sensors import Distance as Distance, Inclination as Inclination, Swivel as Swivel
from .typical_sizes import (
    STEEL_PER_K as STEEL_PER_K,
    TYPICAL_SIZES as TYPICAL_SIZES,
    WARMER_K as WARMER_K,
    TypicalSize as TypicalSize,
    Unstated as Unstated,
)
