"""Errors of the dynamics package.

DynamicsError
├── OutsideDomain      a parameter is outside the model's domain (also a ValueError)
├── NoBalancedState    the pendulums cannot balance this imbalance, so Type I does not exist
└── NotConverged       an iteration or a step-size search did not reach its target
"""

from rig_basics.errors import RigError


class DynamicsError(RigError):
    """Base class of all errors of the dynamics package."""


class OutsideDomain(DynamicsError, ValueError):
    """A parameter is outside the model's domain. The message contains its name, its value and the permitted range."""


class NoBalancedState(DynamicsError):
    """|S_A − S_B| ≤ S_P ≤ S_A + S_B does not hold. The message contains the three moments and the region."""


class NotConverged(DynamicsError):
    """An iteration stopped before its target. The message contains the residual and the target."""
