"""Frequency converters (VFD) by Modbus RTU on a serial port."""
