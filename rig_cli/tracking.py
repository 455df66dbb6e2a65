"""Tracking of the pendulums' damping during a test, from the session's newest readings."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from daq.acquisition.session import Session
from daq.channels import LOCK_A_CLOSED, LOCK_B_CLOSED
from dynamics import RotorParameters
from identification.tracking.tracker import SensorNoise, Tracked, Tracker
from rig_configs import IdentifiedParameters, overridden

_POLL_S = 0.1  # seconds between two reads of the newest readings
_NAMES = (("c3", "c3_Nms_per_rad"), ("c4", "c4_Nms_per_rad"))


def imbalance_std(parameters: Path | None, settings: Sequence[str] = ()) -> float:
    """Return the relative standard deviation of S_P: the parameters file's, else (or if S_P was set) the default."""
    found = IdentifiedParameters({}, np.zeros((0, 0))) if parameters is None else IdentifiedParameters.load(parameters)
    found = found.without(overridden(found, settings))
    if "SP_kg_m" not in found.values:
        return Tracker.imbalance_std
    return found.std["SP_kg_m"] / abs(found.values["SP_kg_m"])


def compile_tracker(physics: RotorParameters) -> None:
    """Compile the filter, which takes ten seconds once, before a session is open and a rotor may turn."""
    Tracker(physics).feed_encoders(np.arange(0, 10**9, 10**7), np.zeros((100, 2)))


class LiveTracking:
    """Tracks an open session in a thread of its own while the context lasts. Its errors never end the test.

    Args:
        session: the tracker starts from its rig's parameters.
        imbalance_std: relative standard deviation of its S_P.
        parameters: a parameters file whose bow acts on the motion; None without one.
    """

    def __init__(
        self, session: Session, imbalance_std: float = Tracker.imbalance_std, parameters: Path | None = None
    ) -> None:
        physics = session.rig.physics
        if parameters is not None:
            physics = IdentifiedParameters.load(parameters).with_effects(physics)
        roles = session.rig.roles
        self._session = session
        self._tracker = Tracker(
            physics,
            SensorNoise(encoder_step_rad=roles.angles.step_rad) if roles.angles else SensorNoise(),
            released=(False, False),
            imbalance_std=imbalance_std,
        )
        self._index_rad = math.radians(roles.phase.index_angle_deg if roles.phase else 0.0)
        self._last_ns = {"pendulums": 0, "tacho": 0}
        self._closed: list[bool | None] = [None, None]
        self._fault = ""
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="tracking", daemon=True)

    def __enter__(self) -> LiveTracking:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        self._thread.join()

    @property
    def now(self) -> Tracked:
        """Present estimate."""
        return self._tracker.estimate()

    def words(self) -> str:
        """Return the estimate for a progress line; empty while it is not trusted."""
        if self._fault:
            return self._fault
        now = self.now
        if not now.trusted:
            return ""
        return ", ".join(f"{short} {now.values[name]:.2e} ± {now.std[name]:.0e}" for short, name in _NAMES)

    def facts(self) -> dict[str, Any]:
        """Return values, 95 % intervals and whether they are trusted, for JSON."""
        now = self.now
        parameters = {name: {"value": now.values[name], "interval": list(now.intervals[name])} for _, name in _NAMES}
        return {"trusted": now.trusted and not self._fault, **parameters}

    def _run(self) -> None:
        try:
            while not self._ending.wait(_POLL_S):
                self.follow()
        except Exception as error:
            self._fault = f"tracking stopped: {error}"

    def follow(self) -> None:
        """Feed the readings since the last call to the tracker."""
        marks, (turns,) = self._new("tacho", ("revolutions",))
        if len(marks):
            self._tracker.feed_marks(marks, 2 * math.pi * turns.astype(float) + self._index_rad)
        time_ns, (a, b, flags) = self._new("pendulums", ("theta3_rad", "theta4_rad", "flags"))
        if len(time_ns):
            self._locks(time_ns, flags)
            self._tracker.feed_encoders(time_ns, np.column_stack([a, b]))

    def _new(self, topic: str, fields: tuple[str, ...]) -> tuple[np.ndarray, list[np.ndarray]]:
        time_ns, columns = self._session.channels.recent.last(topic, fields, self._last_ns[topic] + 1)
        if len(time_ns):
            self._last_ns[topic] = int(time_ns[-1])
        return time_ns, columns

    def _locks(self, time_ns: np.ndarray, flags: np.ndarray) -> None:
        for pendulum, flag in enumerate((LOCK_A_CLOSED, LOCK_B_CLOSED)):
            closed = (flags & flag) != 0
            before = self._closed[pendulum]
            for i in np.flatnonzero(closed != np.r_[not closed[0] if before is None else before, closed[:-1]]):
                switch = self._tracker.lock if closed[i] else self._tracker.release
                switch(pendulum, int(time_ns[i]))
            self._closed[pendulum] = bool(closed[-1])
