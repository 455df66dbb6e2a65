"""Channels of a rig in the units of the page: by role, in mm, degrees and rpm, in seconds since one instant."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from daq.acquisition.rotor_watch import RADIO_S, TURNS_UNSEEN
from daq.channels import ENCODER_FAULT_A, ENCODER_FAULT_B, LOCKS_CLOSED, suspects
from live.levels import KEPT, KEPT_SLOW, Levels
from rig_basics.arrays import Array
from rig_configs.roles import Roles
from rig_configs.schema import Rig

MM: Final = 1e3
DEG: Final = 180 / math.pi
_MAX_REPORT_AGE_S = 1.0


class Signals:
    """Signals of a rig, filled by one thread and read by others.

    Args:
        rig: rig of the channels.
        origin_ns: instant from which seconds count, ns since 1970.
        kept: number of samples of each displacement that are kept; upper limit for other signals.

    Attributes:
        by_name: "x", "y" (mm), "turned3", "turned4" (θ3, θ4, rad, unwrapped), "flags", "drive", "target" (rpm),
            "marks" (rpm between index marks), "turns" (revolutions counted at a mark).
        lock: to be held while several signals are read together.
    """

    def __init__(self, rig: Rig, origin_ns: int, kept: int = KEPT) -> None:
        self.rig: Rig = rig
        self.origin_ns: int = origin_ns
        self._roles: Roles = rig.roles
        names = ("x", "y", "turned3", "turned4", "flags", "drive", "target", "marks", "turns")
        self.by_name: dict[str, Levels] = {
            name: Levels(kept if name in ("x", "y") else min(kept, KEPT_SLOW)) for name in names
        }
        self.lock: threading.RLock = threading.RLock()
        self._axis_of = {d.topic: d.axis for d in self._roles.displacements}
        self._mark: tuple[float, float] | None = None

    @property
    def topics(self) -> dict[str, tuple[str, ...]]:
        """Channels that are needed, each with its fields."""
        found: dict[str, tuple[str, ...]] = dict.fromkeys(self._axis_of, ("displacement_m", "flags"))
        if self._roles.angles is not None:
            found[self._roles.angles.topic] = ("theta3_rad", "theta4_rad", "flags")
        if self._roles.phase is not None:
            found[self._roles.phase.topic] = ("revolutions",)
        if self._roles.speed is not None:
            found[self._roles.speed.topic] = ("speed_rpm", "target_rpm")
        return found

    def seconds(self, time_ns: NDArray[np.int64] | int) -> Any:
        """Convert instants since 1970 to seconds since the origin."""
        return (np.asarray(time_ns, np.int64) - self.origin_ns) * 1e-9

    def feed(self, topic: str, time_ns: NDArray[np.int64], columns: Mapping[str, NDArray[Any]]) -> None:
        """Add new samples of one channel, later than all earlier ones."""
        if not len(time_ns):
            return
        time_s: Array = self.seconds(time_ns)
        with self.lock:
            if topic in self._axis_of:
                values = MM * np.asarray(columns["displacement_m"], np.float64)
                if "flags" in columns:
                    values[suspects(columns["flags"])] = np.nan
                self.by_name[self._axis_of[topic]].add(time_s, values)
            elif self._roles.angles is not None and topic == self._roles.angles.topic:
                self._angles(time_s, columns)
            elif self._roles.phase is not None and topic == self._roles.phase.topic:
                self._marks(time_s, np.asarray(columns["revolutions"], np.float64))
            elif self._roles.speed is not None and topic == self._roles.speed.topic:
                self.by_name["drive"].add(time_s, np.asarray(columns["speed_rpm"], np.float64))
                self.by_name["target"].add(time_s, np.asarray(columns["target_rpm"], np.float64))

    def _angles(self, time_s: Array, columns: Mapping[str, NDArray[Any]]) -> None:
        for number in "34":
            self.by_name[f"turned{number}"].add(time_s, np.asarray(columns[f"theta{number}_rad"], np.float64))
        self.by_name["flags"].add(time_s, np.asarray(columns["flags"], np.float64))

    def _marks(self, time_s: Array, turns: Array) -> None:
        self.by_name["turns"].add(time_s, turns)
        before = self._mark
        self._mark = (float(time_s[-1]), float(turns[-1]))
        if before is not None:
            time_s, turns = np.r_[before[0], time_s], np.r_[before[1], turns]
        spent, turned = np.diff(time_s), np.diff(turns)
        with np.errstate(divide="ignore", invalid="ignore"):
            rpm = np.where((turned > 0) & (turned < 1e3) & (spent > 0), 60 * turned / spent, np.nan)
        self.by_name["marks"].add(time_s[1:], rpm)

    # --- reading -----------------------------------------------------------------------------------------------

    @property
    def newest_s(self) -> float:
        """Time of the newest sample of all signals; -inf without samples."""
        return max(levels.newest_s for levels in self.by_name.values())

    def rpm(self, at_s: float) -> float:
        """Return the rotor's speed at an instant, rpm: by the index marks, after they ceased by the drive; or NaN."""
        marks, drive = self.by_name["marks"], self.by_name["drive"]
        by_marks, age_s = marks.last(at_s), at_s - marks.until(at_s)
        if age_s <= TURNS_UNSEEN * 60.0 / by_marks + RADIO_S:  # False for NaN
            return by_marks
        return drive.last(at_s) if at_s - drive.until(at_s) < _MAX_REPORT_AGE_S else math.nan

    def locked(self, at_s: float) -> bool | None:
        """Whether both pendulums are locked, by their encoders' flags; None if unknown."""
        flags = self.by_name["flags"].last(at_s)
        return None if math.isnan(flags) else int(flags) & LOCKS_CLOSED == LOCKS_CLOSED

    def faulty_share(self, start_s: float, end_s: float) -> float:
        """Return the share of the encoders' samples with a fault flag in an interval; NaN without samples."""
        _, flags = self.by_name["flags"].between(start_s, end_s)
        if not len(flags):
            return math.nan
        faulty = (flags.astype(np.int64) & np.int64(ENCODER_FAULT_A | ENCODER_FAULT_B)) != 0
        return float(np.mean(np.asarray(faulty, dtype=np.float64)))

    def topic_newest_s(self, topic: str, at_s: float) -> float:
        """Return the time of a channel's newest sample not after an instant; -inf without one."""
        if topic in self._axis_of:
            return self.by_name[self._axis_of[topic]].until(at_s)
        names = {
            self._roles.angles and self._roles.angles.topic: "flags",
            self._roles.phase and self._roles.phase.topic: "turns",
            self._roles.speed and self._roles.speed.topic: "drive",
        }
        return self.by_name[names[topic]].until(at_s)
