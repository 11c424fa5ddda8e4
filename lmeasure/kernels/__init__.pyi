from .beside import compile_beside as compile_beside, compile_wanted as compile_wanted
from .cable import (
    ON_AXIS_MM as ON_AXIS_MM,
    changes_from_counts as changes_from_counts,
    counts_from_changes as counts_from_changes,
    guide_direction as guide_direction,
    length_gradients as length_gradients,
    span_lengths as span_lengths,
    span_rows as span_rows,
    span_rows_of as span_rows_of,
    wrap_geometry as wrap_geometry,
)
from .cache import ready as ready
from .clearance import least_clearances as least_clearances
from .counter import (
    BELIEVED_AT as BELIEVED_AT,
    EMPTY as EMPTY,
    FOLLOWED as FOLLOWED,
    FOREIGN as FOREIGN,
    JUMPED as JUMPED,
    PAUSE as PAUSE,
    STATE as STATE,
    UNSURE as UNSURE,
    UNSURE_AT as UNSURE_AT,
    WENT_ON as WENT_ON,
    rests as rests,
    resume_counting as resume_counting,
    runs_on as runs_on,
)
from .decorators import compiled_at_once as compiled_at_once
from .effects import excesses as excesses
from .external import GROUP as GROUP, KINDS as KINDS, set_laws as set_laws
from .frames import (
    BROKEN as BROKEN,
    FIELD_COLUMNS as FIELD_COLUMNS,
    LATEST_S as LATEST_S,
    NAMED_CHANNELS as NAMED_CHANNELS,
    ODD as ODD,
    OTHER_OBJECTS as OTHER_OBJECTS,
    SMALLEST_FRAME_OBJECT as SMALLEST_FRAME_OBJECT,
    WIDE as WIDE,
    Bytes as Bytes,
    Columns as Columns,
    extract as extract,
    scan_blf as scan_blf,
    tabulate as tabulate,
)
from .gaussian import RADIUS_95 as RADIUS_95, radius_95 as radius_95
from .homotopy import REACHED as REACHED, follow_homotopy as follow_homotopy
from .lanes import CLEAR_OF_SINGULAR as CLEAR_OF_SINGULAR, NEAR_MM as NEAR_MM, follow_lanes as follow_lanes
from .lanes_redundant import follow_redundant_lanes as follow_redundant_lanes
from .layout import (
    ALPHA as ALPHA,
    ANGLE_ZERO as ANGLE_ZERO,
    ATTACHMENT as ATTACHMENT,
    ATTACHMENT_XYZ as ATTACHMENT_XYZ,
    AXIAL as AXIAL,
    BASE as BASE,
    BASE_XYZ as BASE_XYZ,
    BETA as BETA,
    BODY_COLUMNS as BODY_COLUMNS,
    BODY_LENGTH as BODY_LENGTH,
    BODY_OF_TOOL as BODY_OF_TOOL,
    BODY_RADIUS as BODY_RADIUS,
    BODY_START as BODY_START,
    BODY_WAY as BODY_WAY,
    BY_ALPHA as BY_ALPHA,
    BY_ANGLE_ZERO as BY_ANGLE_ZERO,
    BY_ATTACHMENT as BY_ATTACHMENT,
    BY_AXIAL as BY_AXIAL,
    BY_BASE as BY_BASE,
    BY_BETA as BY_BETA,
    BY_PITCH as BY_PITCH,
    BY_RADIUS as BY_RADIUS,
    BY_SCALE as BY_SCALE,
    BY_TANGENT as BY_TANGENT,
    CABLE as CABLE,
    CABLE_COLUMNS as CABLE_COLUMNS,
    CABLE_EXPANSION as CABLE_EXPANSION,
    CHANGES as CHANGES,
    CHANNEL_COLUMNS as CHANNEL_COLUMNS,
    CHANNEL_SHIFT as CHANNEL_SHIFT,
    COMPLIANCE as COMPLIANCE,
    COUNT_LENGTH as COUNT_LENGTH,
    DISTANCE as DISTANCE,
    DRUM_EXPANSION as DRUM_EXPANSION,
    ECCENTRIC_PHASE as ECCENTRIC_PHASE,
    ECCENTRICITY as ECCENTRICITY,
    EFFECT_COLUMNS as EFFECT_COLUMNS,
    EXTERNAL_ANGLE as EXTERNAL_ANGLE,
    EXTERNAL_LENGTH as EXTERNAL_LENGTH,
    FRAME_EXPANSION as FRAME_EXPANSION,
    GUIDE_LENGTH as GUIDE_LENGTH,
    GUIDE_XYZ as GUIDE_XYZ,
    INCLINATION as INCLINATION,
    KIND as KIND,
    OWN_COLUMNS as OWN_COLUMNS,
    OWN_PARAMETERS as OWN_PARAMETERS,
    PARAMETERS as PARAMETERS,
    RADIUS as RADIUS,
    SWIVEL as SWIVEL,
    TANGENT as TANGENT,
    TENSION as TENSION,
    TENSION_RISE as TENSION_RISE,
    TRAVEL as TRAVEL,
    TURN_COUNTS as TURN_COUNTS,
    WEIGHT as WEIGHT,
    WIDTH as WIDTH,
)
from .least_squares import damped_search as damped_search, follow_least_squares as follow_least_squares, twists as twists
from .legs import driven as driven, placed as placed, triangles as triangles
from .live import changes_of as changes_of, step as step, step_of as step_of
from .log_asc import EVENTS as EVENTS, scan_asc as scan_asc
from .log_candump import NAME_BYTES as NAME_BYTES, NAMES as NAMES, scan_candump as scan_candump
from .log_text import line_ends as line_ends, line_stop as line_stop
from .motion import LEAST as LEAST, TERMS as TERMS, local_cubics as local_cubics
from .placement import worst_at_task as worst_at_task, worst_of_channels as worst_of_channels
from .polyline import follow_polyline as follow_polyline
from .progress import compilation as compilation
from .screw import (
    CABLES as CABLES,
    LOST as LOST,
    MAX_STEP_ROTATION as MAX_STEP_ROTATION,
    TOLERANCE_MM as TOLERANCE_MM,
    new_state as new_state,
    platform_size as platform_size,
    pose_twists as pose_twists,
    resume_screw as resume_screw,
    solve_pose as solve_pose,
    solve_poses as solve_poses,
)
from .search import best_of as best_of, descend as descend
from .spline import (
    add_spline_prior as add_spline_prior,
    band_inverse as band_inverse,
    spline_covariances as spline_covariances,
    spline_differences as spline_differences,
    spline_equations as spline_equations,
    spline_moved as spline_moved,
    spline_poses as spline_poses,
    spline_steps as spline_steps,
    variances_of_differences as variances_of_differences,
)
from .travel import last_travel as last_travel
from .uncompiled import tile as tile, used as used, wanted as wanted
from .zone import (
    CANNOT_RUN as CANNOT_RUN,
    CLEARANCE as CLEARANCE,
    DET_HIGH as DET_HIGH,
    DET_LOW as DET_LOW,
    FIGURES as FIGURES,
    LONGEST as LONGEST,
    NORM2 as NORM2,
    SHORTEST as SHORTEST,
    SINGULAR as SINGULAR,
    SPEED2 as SPEED2,
    U95_ATTACHMENT as U95_ATTACHMENT,
    U95_POSITION as U95_POSITION,
    U95_ROTATION as U95_ROTATION,
    WORST_START as WORST_START,
    WRAP as WRAP,
    around as around,
    scan as scan,
)
from .zone_lanes import scan_lanes as scan_lanes
from .zone_linked import BLOCK as BLOCK, BLOCKS as BLOCKS, Linked as Linked, roots_by_cable as roots_by_cable
from .zone_rows import LANES as LANES
