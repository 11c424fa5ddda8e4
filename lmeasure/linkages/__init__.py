"""Bodies on straight links from point to point: results from their lines alone, whatever a link is made of.

`topology` names the points in which links meet. `straight_links` finds and proves all poses of given lengths: by `tetrahedra` in closed
form, or from `start_systems` in Study coordinates (`study_quadric`), with the proof in `krawczyk`. `architecture` names rigs that are
singular at every pose. `pluecker` has the rows of the links, `singularity` the screw that they determine least, determinants
and the neighbourhood of singular poses. Only `wrapped_links` knows drums and pulleys: it starts from these assemblies and solves wrapped
cables.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
