"""Several tests' answers as one, how far they agree, and what limits the result."""

from identification.joint.combine import JointEstimate, combine, joint_estimate
from identification.joint.rows import ConsistencyRow

__all__ = ["ConsistencyRow", "JointEstimate", "combine", "joint_estimate"]
