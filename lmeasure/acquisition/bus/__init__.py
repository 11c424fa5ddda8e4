"""CAN buses: adapters, sources of frames, CANopen nodes, a simulated feed."""
