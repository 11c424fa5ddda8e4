from .links import Linkage as Linkage, linkage_of as linkage_of, read_linkage as read_linkage
from .measures import Parts as Parts, parts as parts
from .record import (
    Boundary as Boundary,
    Described as Described,
    Workspace as Workspace,
    all_structures as all_structures,
    described as described,
)
from .slices import Piece as Piece, bounds_of as bounds_of, followed as followed, one_limit as one_limit
from .text import described_lines as described_lines, lines as lines, list_lines as list_lines
