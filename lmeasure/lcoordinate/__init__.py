"""Bodies held by straight links from point to point: what their lines alone tell, whatever a link is made of and however it is measured.

`pluecker` has the rows of the links and their pressure angles, `singular` the screw that they see least, `tetrahedra` the assemblies of
given lengths. Nothing here knows a drum, a pulley or a wrapped cable: those are solved from what is found here (`lmeasure.assemblies`).
"""
