"""Devices: one room each, with its wire format, its pipeline, its dialogue and its simulated far end."""
