"""Choose the reference poses that determine a rig best."""
