from .bounds import Bounds as Bounds, Further as Further, Lines as Lines, PathBounds as PathBounds, ToolLimits as ToolLimits
from .chain import Around as Around, Chain as Chain, grown as grown, proved as proved
from .detours import detour as detour, nearest_pose as nearest_pose
from .flat_tetrahedra import Tetrahedron as Tetrahedron, adjusted as adjusted, clear as clear
from .hooke_joints import HookeJoints as HookeJoints
from .rods import End as End, RodLinks as RodLinks
from .singular_drives import (
    Closing as Closing,
    Drive as Drive,
    extra_drives as extra_drives,
    leading_out as leading_out,
    lost_twists as lost_twists,
    nearest_singular as nearest_singular,
)
from .singularity import (
    LOST as LOST,
    Neighbourhood as Neighbourhood,
    Split as Split,
    architecturally_singular as architecturally_singular,
    gradients as gradients,
    line_pressure_angles as line_pressure_angles,
    link_pressure_angles as link_pressure_angles,
    link_rows as link_rows,
    neighbourhood as neighbourhood,
    pluecker_rows as pluecker_rows,
    pressure_angles as pressure_angles,
    rim_mm as rim_mm,
)
from .start_systems import complex_assemblies as complex_assemblies
from .straight_links import ALL as ALL, NOT_PROVED as NOT_PROVED, Assemblies as Assemblies, assemblies as assemblies
from .tetrahedra import closed_form as closed_form, heights as heights
from .topology import (
    LINKS as LINKS,
    Incidence as Incidence,
    Structure as Structure,
    Variants as Variants,
    class_of as class_of,
    incidence as incidence,
    mobility as mobility,
    parse as parse,
    somov_malyshev as somov_malyshev,
    structures as structures,
)
from .workspace import Boundary as Boundary, Slice as Slice, boundary as boundary, first_met as first_met
from .wrapped_links import (
    SINGULAR as SINGULAR,
    by_side as by_side,
    distances as distances,
    driven as driven,
    wrapped_assemblies as wrapped_assemblies,
)
