"""Planning of experiments by Fisher information: test, duration, amplitude and rate for a required uncertainty."""

from identification.plan.planning import ExperimentPlan, plan_experiments
from identification.plan.requirements import Requirement, parse_requirement
from identification.plan.sensors import SensorProperties

__all__ = ["ExperimentPlan", "Requirement", "SensorProperties", "parse_requirement", "plan_experiments"]
