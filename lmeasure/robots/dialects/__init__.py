"""Programs of robot controllers: their targets are read and written anew, and nothing else in them is touched."""
