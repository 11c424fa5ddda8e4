from .links import (
    Linkage as Linkage,
)
from .links import (
    linkage_of as linkage_of,
)
from .links import (
    read_linkage as read_linkage,
)
from .record import (
    Workspace as Workspace,
)
from .record import (
    all_structures as all_structures,
)
from .record import (
    described as described,
)
from .slices import (
    Piece as Piece,
)
from .slices import (
    bounds_of as bounds_of,
)
from .slices import (
    followed as followed,
)
from .structure import (
    Boundary as Boundary,
)
from .structure import (
    Described as Described,
)
from .structure import (
    structure_of as structure_of,
)
from .text import (
    lines as lines,
)
from .text import (
    told as told,
)
from .text import (
    told_list as told_list,
)
