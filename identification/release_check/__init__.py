"""Validation of the identified model by the transients after releases and by further run-ups."""

from identification.release_check.check import ReleaseRows, check_releases
from identification.release_check.run_ups import check_run_ups

__all__ = ["ReleaseRows", "check_releases", "check_run_ups"]
