from .architecture import (
    architecturally_singular as architecturally_singular,
)
from .bounds import (
    Bounds as Bounds,
)
from .bounds import (
    Lines as Lines,
)
from .chain import (
    Chain as Chain,
)
from .chain import (
    grown as grown,
)
from .chain import (
    proved as proved,
)
from .detours import (
    detour as detour,
)
from .flat_tetrahedra import (
    Tetrahedron as Tetrahedron,
)
from .flat_tetrahedra import (
    adjusted as adjusted,
)
from .flat_tetrahedra import (
    clear as clear,
)
from .length_limits import (
    Around as Around,
)
from .lost_screw import (
    Split as Split,
)
from .pluecker import (
    pluecker_rows as pluecker_rows,
)
from .pluecker import (
    pressure_angles as pressure_angles,
)
from .singularity import (
    LOST as LOST,
)
from .singularity import (
    gradients as gradients,
)
from .singularity import (
    link_pressure_angles as link_pressure_angles,
)
from .singularity import (
    link_rows as link_rows,
)
from .singularity import (
    rim_mm as rim_mm,
)
from .start_systems import (
    complex_assemblies as complex_assemblies,
)
from .straight_links import (
    NOT_PROVED as NOT_PROVED,
)
from .straight_links import (
    Assemblies as Assemblies,
)
from .straight_links import (
    assemblies as assemblies,
)
from .tetrahedra import (
    closed_form as closed_form,
)
from .tetrahedra import (
    heights as heights,
)
from .topology import (
    LINKS as LINKS,
)
from .topology import (
    Incidence as Incidence,
)
from .topology import (
    Structure as Structure,
)
from .topology import (
    class_of as class_of,
)
from .topology import (
    incidence as incidence,
)
from .topology import (
    parse as parse,
)
from .topology import (
    somov_malyshev as somov_malyshev,
)
from .topology import (
    structures as structures,
)
from .workspace import (
    Boundary as Boundary,
)
from .workspace import (
    Slice as Slice,
)
from .workspace import (
    boundary as boundary,
)
from .workspace import (
    first_met as first_met,
)
from .wrapped_links import (
    by_side as by_side,
)
from .wrapped_links import (
    distances as distances,
)
from .wrapped_links import (
    wrapped_assemblies as wrapped_assemblies,
)
