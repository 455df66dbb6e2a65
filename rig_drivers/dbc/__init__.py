"""Sensors on CAN that a DBC file describes. Entry point: driver.py."""
