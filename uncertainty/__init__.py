# pyright: strict
"""Uncertainty of measurement: budgets (JCGM 100), Monte Carlo (JCGM 101), several quantities (JCGM 102).

Knows nothing of rotors: sources of error and a model go in, budgets, intervals and verdicts come out.
"""

from uncertainty.budget import Budget, Contribution, GroupContribution
from uncertainty.budgets import Budgets
from uncertainty.coverage import coverage_factor, ellipsoid_factor, numerical_tolerance
from uncertainty.errors import BadInput, BadModel, TooManyTrials, UncertaintyError
from uncertainty.group import Group, Input
from uncertainty.linear_check import LinearCheck, check_linear
from uncertainty.monte_carlo import monte_carlo
from uncertainty.sensitivities import linear_budgets, second_order_variance
from uncertainty.source import Source, reliability_degrees
from uncertainty.spread import MonteCarlo, Spread

__all__ = [
    "BadInput",
    "BadModel",
    "Budget",
    "Budgets",
    "Contribution",
    "Group",
    "GroupContribution",
    "Input",
    "LinearCheck",
    "MonteCarlo",
    "Source",
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
