"""Displacement sensors that answer one value to one request: Keyence LK-G, LK-G5000, IL; Panasonic HL-G1."""
