"""Floquet multipliers: several methods behind one verb, each answer with a bound on its error."""

from dynamics.floquet.choice import METHODS
from dynamics.floquet.methods import MonodromyMethod
from dynamics.floquet.multipliers import Multipliers, floquet_multipliers

__all__ = ["METHODS", "MonodromyMethod", "Multipliers", "floquet_multipliers"]
