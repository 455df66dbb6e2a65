"""A two-axis inclinometer on a serial line, as a driver.

The device is silent until it receives START. Then it sends a line a sample, with a counter that wraps after 999, its
own time in ms, two angles in units of 1e-6 rad, and a CRC-16 of the characters before the asterisk:

    T 017 0000001700 -123 45*8F3A

It answers ID? with `I tilt-2 SERIAL`, and takes STOP.
"""

from rig_driver_tilt.driver import DRIVER

__all__ = ["DRIVER"]
