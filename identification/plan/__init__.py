"""Which experiment, how long, at what amplitude and rate reaches a wanted uncertainty, by Fisher information."""

from identification.plan.planning import Plan, plan
from identification.plan.sensors import Sensors
from identification.plan.wants import Want, parse_want

__all__ = ["Plan", "Sensors", "Want", "parse_want", "plan"]
