"""Measured steady states against the model: order tracking, validation, report (`analysis.report`)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
