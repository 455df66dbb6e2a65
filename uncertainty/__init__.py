"""Uncertainty of measurement: budgets (JCGM 100), Monte Carlo (JCGM 101), several quantities (JCGM 102).

The input is a set of error sources and a measurement model; the output is budgets, intervals and verdicts. The package
is independent of rotors and of the rest of the project.
"""

import logging

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent until the program shows its log
