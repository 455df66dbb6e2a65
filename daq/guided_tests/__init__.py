"""Guided tests: procedures from locked pendulums to a finished log."""
