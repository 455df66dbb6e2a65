"""Agreement of drive and index marks over the newest samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.recent import Recent
from daq.signals.speed_agreement import SpeedAgreement, speed_agreement
from rig_basics.arrays import Array
from rig_configs.roles import Roles


def recent_agreement(recent: Recent, roles: Roles, since_ns: int) -> SpeedAgreement | None:
    """Compare the drive's reports with the index marks since an instant, ns since 1970.

    Returns:
        Mean speeds; None if the rig lacks one of the two, or if they cannot be compared.
    """
    if roles.speed is None or roles.phase is None:
        return None
    mark_ns, (turns,) = recent.last(roles.phase.topic, ("revolutions",), since_ns)
    report_ns, (rpm,) = recent.last(roles.speed.topic, ("speed_rpm",), since_ns)

    def seconds(ns: NDArray[np.int64]) -> Array:
        return (ns - since_ns).astype(np.float64) * 1e-9

    return speed_agreement(seconds(mark_ns), turns, seconds(report_ns), rpm)
