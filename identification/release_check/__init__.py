"""Whether the model with the identified parameters also follows what happened right after each release."""

from identification.release_check.check import ReleaseRows, check_releases

__all__ = ["ReleaseRows", "check_releases"]
