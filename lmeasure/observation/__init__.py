"""What a channel measures, and the parameters it depends on."""
