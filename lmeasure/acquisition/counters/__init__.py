"""From frames to counts: decoders, one clock, wraps, origins, samples."""
