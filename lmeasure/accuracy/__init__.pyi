from .bodies import (
    read_bodies as read_bodies,
)
from .correction import (
    corrected as corrected,
)
from .correction import (
    correction_columns as correction_columns,
)
from .edge import (
    columns as columns,
)
from .edge import (
    edges as edges,
)
from .faults import (
    VARIABLES as VARIABLES,
)
from .faults import (
    said as said,
)
from .limits import (
    REASONS as REASONS,
)
from .limits import (
    Limits as Limits,
)
from .limits import (
    limit_from_accuracy as limit_from_accuracy,
)
from .placement import (
    GENERATIONS as GENERATIONS,
)
from .placement import (
    Placed as Placed,
)
from .placement import (
    Placement as Placement,
)
from .placement import (
    place as place,
)
from .placement import (
    placement_record as placement_record,
)
from .placement import (
    read_placement as read_placement,
)
from .position_ellipsoids import (
    ellipsoids as ellipsoids,
)
from .program_check import (
    guard as guard,
)
from .program_check import (
    guard_columns as guard_columns,
)
from .radius import (
    exact_radius_95 as exact_radius_95,
)
from .radius import (
    radii_95 as radii_95,
)
from .radius import (
    stated_radii_95 as stated_radii_95,
)
from .surface import (
    zone_surface as zone_surface,
)
from .surroundings import (
    box_around as box_around,
)
from .trajectory_quality import (
    AXIS_95 as AXIS_95,
)
from .trajectory_quality import (
    MOST_STRETCHES as MOST_STRETCHES,
)
from .trajectory_quality import (
    Along as Along,
)
from .trajectory_quality import (
    Stretch as Stretch,
)
from .trajectory_quality import (
    along as along,
)
from .trajectory_quality import (
    kept_rows as kept_rows,
)
from .trajectory_quality import (
    merged as merged,
)
from .zone import (
    MAX_ORIENTATIONS as MAX_ORIENTATIONS,
)
from .zone import (
    Scan as Scan,
)
from .zone import (
    axis as axis,
)
from .zone import (
    map_zone as map_zone,
)
from .zone import (
    scan_zone as scan_zone,
)
from .zone import (
    tilts as tilts,
)
from .zone_dataset import (
    advice as advice,
)
from .zone_dataset import (
    goes_on as goes_on,
)
from .zone_dataset import (
    read_zone as read_zone,
)
from .zone_dataset import (
    reasons as reasons,
)
from .zone_dataset import (
    summary as summary,
)
from .zone_dataset import (
    write_zone as write_zone,
)
from .zone_extent import (
    Extent as Extent,
)
from .zone_extent import (
    extent as extent,
)
