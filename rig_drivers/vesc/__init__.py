"""VESC motor controllers on their serial port."""
