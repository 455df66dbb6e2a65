"""Simulation of the rig: parameters, compiled equations of motion, steady states and stability.

The package reads no files and opens no devices.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
