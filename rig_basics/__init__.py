"""What every package needs: the root of all errors, units, array types. It imports no other package of the project."""

from rig_basics.errors import RigError

__all__ = ["RigError"]
