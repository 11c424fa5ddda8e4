from .dither import dither_gain as dither_gain
from .limits import REASONS as REASONS, Limits as Limits, limit_from_accuracy as limit_from_accuracy, read_bodies as read_bodies
from .placement import (
    GENERATIONS as GENERATIONS,
    Placed as Placed,
    Placement as Placement,
    place as place,
    placement_record as placement_record,
    read_placement as read_placement,
)
from .program_check import (
    corrected as corrected,
    correction_columns as correction_columns,
    guard as guard,
    guard_columns as guard_columns,
    keeping as keeping,
    within as within,
)
from .readings import exact_radius_95 as exact_radius_95, radii_95 as radii_95, stated_radii_95 as stated_radii_95
from .trajectory_quality import (
    AXIS_95 as AXIS_95,
    MOST_STRETCHES as MOST_STRETCHES,
    Along as Along,
    Stretch as Stretch,
    along as along,
    kept_rows as kept_rows,
    merged as merged,
)
from .zone import (
    MAX_ORIENTATIONS as MAX_ORIENTATIONS,
    Scan as Scan,
    axis as axis,
    box_around as box_around,
    ellipsoids as ellipsoids,
    map_zone as map_zone,
    scan_zone as scan_zone,
    tilts as tilts,
)
from .zone_dataset import (
    VARIABLES as VARIABLES,
    advice as advice,
    goes_on as goes_on,
    messages_of as messages_of,
    read_zone as read_zone,
    reasons as reasons,
    said as said,
    sole_reasons as sole_reasons,
    summary as summary,
    write_zone as write_zone,
)
from .zone_extent import Extent as Extent, columns as columns, edges as edges, extent as extent, zone_surface as zone_surface
