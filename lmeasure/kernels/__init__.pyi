from .cable import (
    ON_AXIS_MM as ON_AXIS_MM,
)
from .cable import (
    changes_from_counts as changes_from_counts,
)
from .cable import (
    counts_from_changes as counts_from_changes,
)
from .cable import (
    guide_direction as guide_direction,
)
from .cable import (
    length_gradients as length_gradients,
)
from .cable import (
    span_lengths as span_lengths,
)
from .cable import (
    span_rows as span_rows,
)
from .cable import (
    span_rows_of as span_rows_of,
)
from .cable import (
    wrap_geometry as wrap_geometry,
)
from .cache import (
    ready as ready,
)
from .clearance import (
    least_clearances as least_clearances,
)
from .counter import (
    BELIEVED_AT as BELIEVED_AT,
)
from .counter import (
    EMPTY as EMPTY,
)
from .counter import (
    FOLLOWED as FOLLOWED,
)
from .counter import (
    FOREIGN as FOREIGN,
)
from .counter import (
    JUMPED as JUMPED,
)
from .counter import (
    PAUSE as PAUSE,
)
from .counter import (
    STATE as STATE,
)
from .counter import (
    UNSURE as UNSURE,
)
from .counter import (
    UNSURE_AT as UNSURE_AT,
)
from .counter import (
    WENT_ON as WENT_ON,
)
from .counter import (
    rests as rests,
)
from .counter import (
    resume_counting as resume_counting,
)
from .counter import (
    runs_on as runs_on,
)
from .damped import (
    damped_search as damped_search,
)
from .effects import (
    excesses as excesses,
)
from .frames import (
    BROKEN as BROKEN,
)
from .frames import (
    FIELD_COLUMNS as FIELD_COLUMNS,
)
from .frames import (
    LATEST_S as LATEST_S,
)
from .frames import (
    NAMED_CHANNELS as NAMED_CHANNELS,
)
from .frames import (
    ODD as ODD,
)
from .frames import (
    OTHER_OBJECTS as OTHER_OBJECTS,
)
from .frames import (
    SMALLEST_FRAME_OBJECT as SMALLEST_FRAME_OBJECT,
)
from .frames import (
    WIDE as WIDE,
)
from .frames import (
    Bytes as Bytes,
)
from .frames import (
    Columns as Columns,
)
from .frames import (
    extract as extract,
)
from .frames import (
    scan_blf as scan_blf,
)
from .frames import (
    tabulate as tabulate,
)
from .gaussian import (
    RADIUS_95 as RADIUS_95,
)
from .gaussian import (
    radius_95 as radius_95,
)
from .homotopy import (
    REACHED as REACHED,
)
from .homotopy import (
    follow_homotopy as follow_homotopy,
)
from .lanes import (
    CLEAR_OF_SINGULAR as CLEAR_OF_SINGULAR,
)
from .lanes import (
    NEAR_MM as NEAR_MM,
)
from .lanes import (
    follow_lanes as follow_lanes,
)
from .lanes_redundant import (
    follow_redundant_lanes as follow_redundant_lanes,
)
from .layout import (
    ALPHA as ALPHA,
)
from .layout import (
    ANGLE_ZERO as ANGLE_ZERO,
)
from .layout import (
    ATTACHMENT as ATTACHMENT,
)
from .layout import (
    ATTACHMENT_XYZ as ATTACHMENT_XYZ,
)
from .layout import (
    AXIAL as AXIAL,
)
from .layout import (
    BASE as BASE,
)
from .layout import (
    BASE_XYZ as BASE_XYZ,
)
from .layout import (
    BETA as BETA,
)
from .layout import (
    BODY_COLUMNS as BODY_COLUMNS,
)
from .layout import (
    BODY_LENGTH as BODY_LENGTH,
)
from .layout import (
    BODY_OF_TOOL as BODY_OF_TOOL,
)
from .layout import (
    BODY_RADIUS as BODY_RADIUS,
)
from .layout import (
    BODY_START as BODY_START,
)
from .layout import (
    BODY_WAY as BODY_WAY,
)
from .layout import (
    BY_ALPHA as BY_ALPHA,
)
from .layout import (
    BY_ANGLE_ZERO as BY_ANGLE_ZERO,
)
from .layout import (
    BY_ATTACHMENT as BY_ATTACHMENT,
)
from .layout import (
    BY_AXIAL as BY_AXIAL,
)
from .layout import (
    BY_BASE as BY_BASE,
)
from .layout import (
    BY_BETA as BY_BETA,
)
from .layout import (
    BY_PITCH as BY_PITCH,
)
from .layout import (
    BY_RADIUS as BY_RADIUS,
)
from .layout import (
    BY_SCALE as BY_SCALE,
)
from .layout import (
    BY_TANGENT as BY_TANGENT,
)
from .layout import (
    CABLE as CABLE,
)
from .layout import (
    CABLE_COLUMNS as CABLE_COLUMNS,
)
from .layout import (
    CABLE_EXPANSION as CABLE_EXPANSION,
)
from .layout import (
    CHANGES as CHANGES,
)
from .layout import (
    CHANNEL_COLUMNS as CHANNEL_COLUMNS,
)
from .layout import (
    CHANNEL_SHIFT as CHANNEL_SHIFT,
)
from .layout import (
    COMPLIANCE as COMPLIANCE,
)
from .layout import (
    COUNT_LENGTH as COUNT_LENGTH,
)
from .layout import (
    DRUM_EXPANSION as DRUM_EXPANSION,
)
from .layout import (
    ECCENTRIC_PHASE as ECCENTRIC_PHASE,
)
from .layout import (
    ECCENTRICITY as ECCENTRICITY,
)
from .layout import (
    EFFECT_COLUMNS as EFFECT_COLUMNS,
)
from .layout import (
    FRAME_EXPANSION as FRAME_EXPANSION,
)
from .layout import (
    GUIDE_LENGTH as GUIDE_LENGTH,
)
from .layout import (
    GUIDE_XYZ as GUIDE_XYZ,
)
from .layout import (
    INCLINATION as INCLINATION,
)
from .layout import (
    KIND as KIND,
)
from .layout import (
    PARAMETERS as PARAMETERS,
)
from .layout import (
    RADIUS as RADIUS,
)
from .layout import (
    SWIVEL as SWIVEL,
)
from .layout import (
    TANGENT as TANGENT,
)
from .layout import (
    TENSION as TENSION,
)
from .layout import (
    TENSION_RISE as TENSION_RISE,
)
from .layout import (
    TRAVEL as TRAVEL,
)
from .layout import (
    TURN_COUNTS as TURN_COUNTS,
)
from .layout import (
    WEIGHT as WEIGHT,
)
from .layout import (
    WIDTH as WIDTH,
)
from .least_squares import (
    follow_least_squares as follow_least_squares,
)
from .least_squares import (
    twists as twists,
)
from .legs import (
    driven as driven,
)
from .legs import (
    placed as placed,
)
from .legs import (
    triangles as triangles,
)
from .live import (
    changes_of as changes_of,
)
from .live import (
    step as step,
)
from .live import (
    step_of as step_of,
)
from .log_asc import (
    EVENTS as EVENTS,
)
from .log_asc import (
    scan_asc as scan_asc,
)
from .log_candump import (
    NAME_BYTES as NAME_BYTES,
)
from .log_candump import (
    NAMES as NAMES,
)
from .log_candump import (
    scan_candump as scan_candump,
)
from .log_text import (
    line_ends as line_ends,
)
from .log_text import (
    line_stop as line_stop,
)
from .motion import (
    LEAST as LEAST,
)
from .motion import (
    TERMS as TERMS,
)
from .motion import (
    local_cubics as local_cubics,
)
from .placement import (
    worst_at_task as worst_at_task,
)
from .placement import (
    worst_of_channels as worst_of_channels,
)
from .polyline import (
    follow_polyline as follow_polyline,
)
from .pose_covariance import (
    pose_covariances as pose_covariances,
)
from .pose_covariance import (
    pose_twists as pose_twists,
)
from .progress import (
    compilation as compilation,
)
from .screw import (
    CABLES as CABLES,
)
from .screw import (
    LOST as LOST,
)
from .screw import (
    MAX_STEP_ROTATION as MAX_STEP_ROTATION,
)
from .screw import (
    TOLERANCE_MM as TOLERANCE_MM,
)
from .screw import (
    new_state as new_state,
)
from .screw import (
    platform_size as platform_size,
)
from .screw import (
    resume_screw as resume_screw,
)
from .screw import (
    solve_pose as solve_pose,
)
from .screw import (
    solve_poses as solve_poses,
)
from .search import (
    best_of as best_of,
)
from .search import (
    descend as descend,
)
from .travel import (
    last_travel as last_travel,
)
from .zone import (
    CANNOT_RUN as CANNOT_RUN,
)
from .zone import (
    CLEARANCE as CLEARANCE,
)
from .zone import (
    DET_HIGH as DET_HIGH,
)
from .zone import (
    DET_LOW as DET_LOW,
)
from .zone import (
    FIGURES as FIGURES,
)
from .zone import (
    LONGEST as LONGEST,
)
from .zone import (
    NORM2 as NORM2,
)
from .zone import (
    SHORTEST as SHORTEST,
)
from .zone import (
    SINGULAR as SINGULAR,
)
from .zone import (
    SPEED2 as SPEED2,
)
from .zone import (
    U95_ATTACHMENT as U95_ATTACHMENT,
)
from .zone import (
    U95_POSITION as U95_POSITION,
)
from .zone import (
    U95_ROTATION as U95_ROTATION,
)
from .zone import (
    WORST_START as WORST_START,
)
from .zone import (
    WRAP as WRAP,
)
from .zone import (
    around as around,
)
from .zone import (
    scan as scan,
)
from .zone_lanes import (
    scan_lanes as scan_lanes,
)
from .zone_linked import (
    BLOCK as BLOCK,
)
from .zone_linked import (
    BLOCKS as BLOCKS,
)
from .zone_linked import (
    Linked as Linked,
)
from .zone_linked import (
    roots_by_cable as roots_by_cable,
)
from .zone_linked import (
    strict_gradients as strict_gradients,
)
from .zone_linked import (
    strict_lengths as strict_lengths,
)
from .zone_rows import (
    LANES as LANES,
)
