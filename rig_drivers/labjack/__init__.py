"""LabJack T4 and T7 by Modbus TCP: analogue displacement sensors, a tachometer and other analogue quantities."""
