# pyright: strict
"""Errors of the reproduction."""

from __future__ import annotations


class ReproductionError(Exception):
    """Base of all."""


class UnknownItem(ReproductionError):
    """No item of the source has this number."""


class NoDataOfSeries(ReproductionError):
    """A recording of an item's series did not reach its end."""
