"""Clock of an imported recording: uncertainty of its rate, and identity with the clocks of other files.

Recordings do not contain the accuracy of their clock. A relative rate error r changes k by 2 r and c by r. One file has
one clock: its columns of times share a zero, and therefore the clock.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from daq.signals.run_clocks import ASSUMED_TOLERANCE_PPM
from rig_configs.schema import Rig

_TOLERANCE = "clock_tolerance_ppm"


@dataclass(frozen=True)
class RecorderClock:
    """Clock of a recording.

    Attributes:
        tolerance_ppm: relative standard uncertainty of its rate, ppm.
        basis: source of the tolerance: "stated", "rig file" or "assumed".
        recorder: the operator's name for the recorder; "" if none was given.
    """

    tolerance_ppm: float
    basis: str
    recorder: str = ""

    @property
    def facts(self) -> dict[str, str]:
        """Facts for the log."""
        facts = {"clock_tolerance_ppm": repr(self.tolerance_ppm), "clock_tolerance_from": self.basis}
        return facts | ({"recorder": self.recorder} if self.recorder else {})

    @property
    def warning(self) -> str | None:
        """Warning about an assumed tolerance."""
        if self.basis != "assumed":
            return None
        return (
            f"the recorder's clock is assumed to be accurate to {self.tolerance_ppm:g} ppm (one standard deviation): "
            "neither the rig file nor the import states its accuracy"
        )


def recorder_clock(stated_ppm: float | None, recorder: str, rig: Rig, topics: Iterable[str]) -> RecorderClock:
    """Return the clock of a file.

    Args:
        stated_ppm: tolerance stated by the operator, ppm; None if not stated.
        recorder: the operator's name for the recorder, or "".
        rig: rig file, which may state the tolerances of the devices' clocks.
        topics: channels in the file; the largest tolerance of the devices that fill them is used.
    """
    if stated_ppm is not None:
        return RecorderClock(stated_ppm, "stated", recorder)
    filled, wanted = rig.roles.device_of, set(topics)
    devices = [rig.devices[device] for device in sorted({filled[topic] for topic in wanted if topic in filled})]
    stated = [float(getattr(d, _TOLERANCE)) for d in devices if _TOLERANCE in d.model_fields_set]
    if stated and len(stated) == len(devices) and wanted <= filled.keys():
        return RecorderClock(max(stated), "rig file", recorder)
    return RecorderClock(max([ASSUMED_TOLERANCE_PPM, *stated]), "assumed", recorder)
