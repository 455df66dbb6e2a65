"""Planning of experiments by Fisher information: test, duration, amplitude and rate for a required uncertainty."""

from identification.plan.planning import Plan, plan
from identification.plan.sensors import Sensors
from identification.plan.wants import Want, parse_want

__all__ = ["Plan", "Sensors", "Want", "parse_want", "plan"]
