"""Factors between the units at the borders and SI."""

from __future__ import annotations

import math

RAD_PER_S_PER_RPM = math.pi / 30
"""rad/s in one revolution per minute."""

RPM_PER_RAD_PER_S = 30 / math.pi
"""Revolutions per minute in one rad/s."""
