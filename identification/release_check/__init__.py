"""Whether the model with the identified parameters also follows what happened right after each release, and run-ups."""

from identification.release_check.check import ReleaseRows, check_releases
from identification.release_check.run_ups import check_run_ups

__all__ = ["ReleaseRows", "check_releases", "check_run_ups"]
