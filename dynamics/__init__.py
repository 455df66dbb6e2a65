"""Simulation of the rig: parameters, compiled equations of motion, steady states and stability.

The package reads no files and opens no devices.
"""

import logging

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent until the program shows its log
