"""Planning of experiments by Fisher information: test, duration, amplitude and rate for a required uncertainty."""

from identification.plan.planning import Plan, plan
from identification.plan.requirements import Requirement, parse_requirement
from identification.plan.sensors import Sensors

__all__ = ["Plan", "Requirement", "Sensors", "parse_requirement", "plan"]
