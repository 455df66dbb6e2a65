"""Factors between the units at the borders and SI."""

from __future__ import annotations

import math

RPM = math.pi / 30
"""One revolution per minute in rad/s: `speed_rpm * RPM` is in rad/s."""

TO_RPM = 30 / math.pi
"""One rad/s in revolutions per minute: `speed_rad_s * TO_RPM` is in rpm."""
