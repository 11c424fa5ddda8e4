"""Log files of CAN frames: one module for each format, a registry, and the import into a run."""
