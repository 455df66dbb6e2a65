"""Measured steady states against the model: order tracking, validation, report."""
