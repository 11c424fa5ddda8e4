from .cable import (
    CableLength as CableLength,
)
from .cable_effects import (
    REFERENCE_C as REFERENCE_C,
)
from .cable_effects import (
    Effects as Effects,
)
from .cable_effects import (
    Zero as Zero,
)
from .cable_effects import (
    effects_of as effects_of,
)
from .cable_effects import (
    zero_at as zero_at,
)
from .cable_parameters import (
    cable_covariance as cable_covariance,
)
from .cable_parameters import (
    channel_names as channel_names,
)
from .cable_parameters import (
    further_solved as further_solved,
)
from .cable_parameters import (
    length_gradients_since as length_gradients_since,
)
from .cable_parameters import (
    solved_covariance as solved_covariance,
)
from .cable_parameters import (
    unsolved_columns as unsolved_columns,
)
from .cable_parameters import (
    width_of as width_of,
)
from .channel import (
    Channels as Channels,
)
from .channel import (
    Observation as Observation,
)
from .channel import (
    differences as differences,
)
from .channel import (
    variances as variances,
)
from .continuation import (
    follow as follow,
)
from .effect_laws import (
    ATTACHMENT as ATTACHMENT,
)
from .effect_laws import (
    DIMENSIONS as DIMENSIONS,
)
from .effect_laws import (
    ECCENTRICITY as ECCENTRICITY,
)
from .effect_laws import (
    OFFSET as OFFSET,
)
from .effect_laws import (
    OTHERS as OTHERS,
)
from .effect_laws import (
    RUN_OUT as RUN_OUT,
)
from .imperfect_parts import (
    PART_ECCENTRICITY as PART_ECCENTRICITY,
)
from .imperfect_parts import (
    PLAY as PLAY,
)
from .imperfect_parts import (
    Parts as Parts,
)
from .imperfect_parts import (
    every_part as every_part,
)
from .imperfect_parts import (
    parts_of as parts_of,
)
from .imperfect_parts import (
    phased as phased,
)
from .lengths import (
    COUNTER_STATE as COUNTER_STATE,
)
from .lengths import (
    MAX_ROUNDS as MAX_ROUNDS,
)
from .lengths import (
    LengthResiduals as LengthResiduals,
)
from .lengths import (
    Lengths as Lengths,
)
from .lengths import (
    changes_from_counts as changes_from_counts,
)
from .lengths import (
    count_variance as count_variance,
)
from .lengths import (
    counts_from_poses as counts_from_poses,
)
from .lengths import (
    length_residuals as length_residuals,
)
from .lengths import (
    lengths_from_counts as lengths_from_counts,
)
from .lengths import (
    read_lengths as read_lengths,
)
from .lengths import (
    recorded_from_counts as recorded_from_counts,
)
from .lengths import (
    span_lengths as span_lengths,
)
from .lengths import (
    with_reasons as with_reasons,
)
from .lengths import (
    write_lengths as write_lengths,
)
from .lengths import (
    zero_temperature as zero_temperature,
)
from .rejected_samples import (
    ARM_MM as ARM_MM,
)
from .rejected_samples import (
    Reason as Reason,
)
from .rejected_samples import (
    rate_notes as rate_notes,
)
from .rig_channels import (
    cable_lengths as cable_lengths,
)
from .rig_channels import (
    rig_inclination as rig_inclination,
)
from .rig_channels import (
    swivel_angle as swivel_angle,
)
from .solver import (
    pressure_angles as pressure_angles,
)
from .solver import (
    shared_errors as shared_errors,
)
from .solver import (
    twists as twists,
)
from .stated_errors import (
    CALIBRATION as CALIBRATION,
)
from .stated_errors import (
    CAMPAIGN as CAMPAIGN,
)
from .stated_errors import (
    RIG as RIG,
)
from .stated_errors import (
    Taken as Taken,
)
from .stated_errors import (
    Unsolved as Unsolved,
)
from .stated_errors import (
    Variable as Variable,
)
from .stated_errors import (
    Warmth as Warmth,
)
from .stated_errors import (
    exact as exact,
)
from .stated_errors import (
    last_travel as last_travel,
)
from .stated_errors import (
    of_record as of_record,
)
from .stated_errors import (
    stated as stated,
)
from .stated_errors import (
    taken_as_exact as taken_as_exact,
)
from .stated_errors import (
    worst as worst,
)
from .wrap import (
    arms as arms,
)
from .wrap import (
    guide as guide,
)
from .wrap import (
    span as span,
)
from .wrap import (
    span_rows as span_rows,
)
from .zero_phase import (
    drawn_phases as drawn_phases,
)
from .zero_phase import (
    length_variance as length_variance,
)
from .zero_phase import (
    phase_columns as phase_columns,
)
from .zero_phase import (
    zeroed_exactly as zeroed_exactly,
)
