"""Errors of the dynamics package.

DynamicsError
├── OutsideDomain      a parameter lies where the model is not valid (also a ValueError)
├── NoBalancedState    the pendulums can't balance this imbalance, so there is no Type I
└── NotConverged       an iteration or a step-size search did not reach its target
"""


class DynamicsError(Exception):
    """Root of everything the dynamics package raises on purpose."""


class OutsideDomain(DynamicsError, ValueError):
    """A parameter lies outside the model's domain; the message names it, its value and the allowed range."""


class NoBalancedState(DynamicsError):
    """|S_A − S_B| ≤ S_P ≤ S_A + S_B does not hold; the message gives the three moments and the region."""


class NotConverged(DynamicsError):
    """An iteration stopped before its target; the message gives the residual and the target."""
