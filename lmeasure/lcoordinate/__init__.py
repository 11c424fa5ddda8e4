"""Bodies held by straight links from point to point: what their lines alone tell, whatever a link is made of and however it is measured.

`structures` says which links meet in which points, `straight` finds and proves all assemblies of given lengths: `tetrahedra` in closed
form, or followed from `starts` in Study coordinates (`study`); `certified` is the proof. `architecture` names rigs that are singular at
every pose. `pluecker` has the rows of the links and their pressure angles, `singular` the screw that they see least, `singularity`
determinants and what lies around singular poses. Nothing here knows a drum, a pulley or a wrapped cable: those are solved from what is
found here (`lmeasure.assemblies`).
"""
