"""Calibration of an open rig: displacement sensors against known positions, encoders against their locks.

The steps use the same session, drivers and bytes as a test. The theory is in docs/theory/calibration.md.
"""
