"""The tests of ISO 9283:1998 as a robot runs them."""
