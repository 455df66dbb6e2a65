"""Joint estimate of several tests, agreement of the tests, and the sources that limit the result."""

from identification.joint.combine import JointEstimate, combine, joint_estimate
from identification.joint.rows import ConsistencyRow

__all__ = ["ConsistencyRow", "JointEstimate", "combine", "joint_estimate"]
