"""Estimation of k1, k2, ζ1, ζ2, c3, c4 and S_P from recorded runs, with covariance."""

import logging

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent until the program shows its log
