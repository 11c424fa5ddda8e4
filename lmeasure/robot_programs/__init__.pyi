from .configuration import (
    fits as fits,
)
from .correction import (
    Corrected as Corrected,
)
from .correction import (
    Outcome as Outcome,
)
from .correction import (
    as_record as as_record,
)
from .correction import (
    corrected_program as corrected_program,
)
from .correction import (
    identified_mm as identified_mm,
)
from .euler import (
    of_angles as of_angles,
)
from .map_correction import (
    mapped_program as mapped_program,
)
from .program import (
    Dialect as Dialect,
)
from .program import (
    Listing as Listing,
)
from .program import (
    Source as Source,
)
from .program import (
    Target as Target,
)
from .program import (
    Unread as Unread,
)
from .registry import (
    dialect_names as dialect_names,
)
from .registry import (
    dialect_of as dialect_of,
)
from .registry import (
    is_dialect as is_dialect,
)
from .registry import (
    opened as opened,
)
