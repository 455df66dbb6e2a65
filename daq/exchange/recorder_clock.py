# pyright: strict
"""The clock that stamped a recording made elsewhere: how well its rate is known, and which other files it stamped.

No recording says how good its clock was, and none is exact: a rate that is off by r moves k by 2 r and c by r. One
file has one clock; its columns of times share a zero, and with it the clock.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from daq.signals.run import ASSUMED_TOLERANCE_PPM
from rig_configs.schema import Rig

_TOLERANCE = "clock_tolerance_ppm"


@dataclass(frozen=True)
class RecorderClock:
    """A recording's clock.

    Attributes:
        tolerance_ppm: relative standard uncertainty of its rate, parts per million.
        basis: where that is from: "stated", "rig file" or "assumed".
        recorder: the operator's name for the recorder; "" for the one that nothing is known of.
    """

    tolerance_ppm: float
    basis: str
    recorder: str = ""

    @property
    def facts(self) -> dict[str, str]:
        """As a log keeps them."""
        facts = {"clock_tolerance_ppm": repr(self.tolerance_ppm), "clock_tolerance_from": self.basis}
        return facts | ({"recorder": self.recorder} if self.recorder else {})

    @property
    def warning(self) -> str | None:
        """What a reader must know of it."""
        if self.basis != "assumed":
            return None
        return (
            f"the recorder's clock is taken as good to {self.tolerance_ppm:g} ppm (one standard deviation): "
            "neither the rig file nor --clock-tolerance-ppm says how good it is"
        )


def recorder_clock(stated_ppm: float | None, recorder: str, rig: Rig, topics: Iterable[str]) -> RecorderClock:
    """The clock of a file.

    Args:
        stated_ppm: what the operator says of it, if anything.
        recorder: the operator's name for the recorder, or "".
        rig: its file may say how good the devices' clocks are.
        topics: of the channels that the file holds; the least certain of the devices that fill them on the rig counts.
    """
    if stated_ppm is not None:
        return RecorderClock(stated_ppm, "stated", recorder)
    filled, wanted = rig.roles.device_of, set(topics)
    told = [rig.devices[device] for device in sorted({filled[topic] for topic in wanted if topic in filled})]
    known = [float(getattr(d, _TOLERANCE)) for d in told if _TOLERANCE in d.model_fields_set]
    if known and len(known) == len(told) and wanted <= filled.keys():
        return RecorderClock(max(known), "rig file", recorder)
    return RecorderClock(max([ASSUMED_TOLERANCE_PPM, *known]), "assumed", recorder)
