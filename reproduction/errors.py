"""Errors of the reproduction.

ReproductionError
├── UnknownItem       no item of the source has this number
└── NoDataOfSeries    a recording of an item's series did not reach its end
"""

from __future__ import annotations

from rig_basics.errors import RigError


class ReproductionError(RigError):
    """Root of the errors of the reproduction."""


class UnknownItem(ReproductionError):
    """No item of the source has this number."""


class NoDataOfSeries(ReproductionError):
    """A recording of an item's series did not reach its end."""
