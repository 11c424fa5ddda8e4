"""Points and links of a rig or a sketch, and all that is known of them before anything is measured: what `lmeasure structure` is made of.

`links` reads them, `found` has the assemblies of their lengths, straight or wrapped, `measures` how well a pose is held, `slices` the
boundary of the workspace, `design` limits of lengths within which nothing is singular, and `record` puts it together.
"""
