"""Tests that lead an operator from locked pendulums to a finished log."""
