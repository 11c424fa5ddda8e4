"""Every frame sent or received: buses, log files, decoders, counters, the recorder, the simulated feed."""
