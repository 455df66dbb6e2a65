# pyright: strict
"""Uncertainty of measurement: budgets (JCGM 100), Monte Carlo (JCGM 101), several quantities (JCGM 102).

The input is a set of error sources and a measurement model; the output is budgets, intervals and verdicts. The package
is independent of rotors and of the rest of the project.
"""

from uncertainty.budget import Budget, Contribution, GroupContribution
from uncertainty.budgets import Budgets
from uncertainty.coverage import coverage_factor, ellipsoid_factor, numerical_tolerance
from uncertainty.errors import BadInput, BadModel, TooManyTrials, UncertaintyError
from uncertainty.group import Group, Input
from uncertainty.linear_check import LinearCheck, check_linear
from uncertainty.monte_carlo import monte_carlo
from uncertainty.sensitivities import linear_budgets, second_order_variance
from uncertainty.source import ErrorSource, reliability_degrees
from uncertainty.spread import MonteCarlo, Spread

__all__ = [
    "BadInput",
    "BadModel",
    "Budget",
    "Budgets",
    "Contribution",
    "ErrorSource",
    "Group",
    "GroupContribution",
    "Input",
    "LinearCheck",
    "MonteCarlo",
    "Spread",
    "TooManyTrials",
    "UncertaintyError",
    "check_linear",
    "coverage_factor",
    "ellipsoid_factor",
    "linear_budgets",
    "monte_carlo",
    "numerical_tolerance",
    "reliability_degrees",
    "second_order_variance",
]
