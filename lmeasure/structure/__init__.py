"""Points and links of a rig or a sketch, and all that is known of them before anything is measured.

`links` reads them, `assemblies` finds the poses of their lengths, `measures` how well a pose is held, `slices` the boundary of the
workspace, `design` limits of lengths without a singular pose, and `record` puts it together.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
