"""Robots whose platform is held by six equations of legs: rods, struts, cranks, carriages on a circle or a line, in any mixture."""
