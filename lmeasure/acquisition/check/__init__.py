"""The self-test of a wired rig: which channel is which cable or encoder, and which way it counts."""
