from .cable_effects import REFERENCE_C as REFERENCE_C, Effects as Effects, Zero as Zero, effects_of as effects_of, zero_at as zero_at
from .cable_parameters import (
    axial_travel as axial_travel,
    cable_covariance as cable_covariance,
    channel_names as channel_names,
    further_solved as further_solved,
    length_gradients_since as length_gradients_since,
    solved_covariance as solved_covariance,
    unsolved_dimensions as unsolved_dimensions,
    width_of as width_of,
)
from .channels import Channels as Channels
from .effect_laws import (
    ATTACHMENT as ATTACHMENT,
    BACKLASH as BACKLASH,
    DIMENSIONS as DIMENSIONS,
    ECCENTRICITY as ECCENTRICITY,
    OFFSET as OFFSET,
    OTHERS as OTHERS,
    RUN_OUT as RUN_OUT,
)
from .imperfect_parts import (
    PART_ECCENTRICITY as PART_ECCENTRICITY,
    PART_RUN_OUT as PART_RUN_OUT,
    PLAY as PLAY,
    Parts as Parts,
    every_part as every_part,
    parts_of as parts_of,
    phased as phased,
)
from .lengths import (
    COUNTER_STATE as COUNTER_STATE,
    MAX_ROUNDS as MAX_ROUNDS,
    LengthResiduals as LengthResiduals,
    Lengths as Lengths,
    changes_from_counts as changes_from_counts,
    channel_message as channel_message,
    count_variance as count_variance,
    counts_from_poses as counts_from_poses,
    drawn_phases as drawn_phases,
    length_residuals as length_residuals,
    length_variance as length_variance,
    lengths_from_counts as lengths_from_counts,
    phase_columns as phase_columns,
    read_lengths as read_lengths,
    recorded_from_counts as recorded_from_counts,
    rounding_variance as rounding_variance,
    span_lengths as span_lengths,
    with_reasons as with_reasons,
    write_lengths as write_lengths,
    zero_temperature as zero_temperature,
    zeroed_exactly as zeroed_exactly,
)
from .rejected_samples import ARM_MM as ARM_MM, Reason as Reason, rate_notes as rate_notes
from .sensor_kind import AngleSensor as AngleSensor, LengthSensor as LengthSensor, SensorKind as SensorKind
from .stated_errors import (
    Unsolved as Unsolved,
    Variable as Variable,
    free_lengths as free_lengths,
    last_travel as last_travel,
    of_record as of_record,
    phase_errors as phase_errors,
    stated as stated,
)
from .wrap import arms as arms, drum_of as drum_of, guide as guide, span as span, span_rows as span_rows
