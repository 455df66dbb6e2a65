"""Floquet multipliers by several methods, each result with a bound on its error."""

from dynamics.stability.floquet.choice import METHODS
from dynamics.stability.floquet.methods import MonodromyMethod
from dynamics.stability.floquet.multipliers import Multipliers, floquet_multipliers

__all__ = ["METHODS", "MonodromyMethod", "Multipliers", "floquet_multipliers"]
