"""Pictures for one viewer at an instant: frames of numbers, and the state in words.

Every frame is complete. A slow viewer misses frames but never displays a wrong one, and unsent frames are not kept.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from live.angles import shown_deg, within_a_turn
from live.followers import Followers
from live.frames import encode
from live.limits import Lamps, distances
from live.model import LiveModel, Predicted
from live.planned import SpeedRamp
from live.signals import DEG
from live.source import Facts, PageSource
from live.vectors import clocks_of, without_lags
from rig_basics.arrays import Array

STRIPS = ("x", "y", "theta3", "theta4", "drive", "target", "marks")
_VECTOR = ("rpm", "x.re", "x.im", "y.re", "y.im")
_TURNED = {"theta3": "turned3", "theta4": "turned4"}  # angles are kept unwrapped, in rad
STALE_S = 0.6
"""Wall time without a sample after which a panel is marked, s; the page checks 30 times per second.

The page marks a line that has been silent for 0.7 s."""
_MAX_WINDOW_S, _MIN_WINDOW_S = 1e6, 0.02
_MAX_PIXELS, _MIN_PIXELS = 4000, 50
_ORBIT_TURNS, _ORBIT_S, _ORBIT_POINTS = 2.0, (0.1, 1.0), 600
_EVENTS_SHOWN = 40
_ELLIPSE = np.exp(2j * np.pi * np.arange(97) / 96)


@dataclass(frozen=True)
class ViewerView:
    """View of a viewer.

    Attributes:
        window_s: length of the window, s.
        end_s: end of the window; None for the displayed instant.
        pixels: width of a strip chart.
    """

    window_s: float = 10.0
    end_s: float | None = None
    pixels: int = 600

    @classmethod
    def of(cls, request: Mapping[str, Any]) -> ViewerView:
        """Return the view requested by the page, limited to the possible range.

        Raises:
            ValueError, TypeError, KeyError: the values are missing or not finite numbers.
        """
        end = request.get("end_s")
        window, pixels = float(request["window_s"]), float(request["pixels"])
        if not (math.isfinite(window) and math.isfinite(pixels) and (end is None or math.isfinite(float(end)))):
            raise ValueError(f"expected finite numbers of a view, got {dict(request)}")
        return cls(
            min(max(window, _MIN_WINDOW_S), _MAX_WINDOW_S),
            None if end is None else float(end),
            int(min(max(pixels, _MIN_PIXELS), _MAX_PIXELS)),
        )


class Pictures:
    """Creates the pictures.

    Args:
        source: displayed source.
        model: model of its rig.
        followers: followers of its signals.
    """

    def __init__(self, source: PageSource, model: LiveModel, followers: Followers) -> None:
        self._source, self._model, self._followers = source, model, followers
        self._signals = source.signals
        self._lamps = Lamps(source.signals)

    def frame(self, view: ViewerView, number: int) -> bytes:
        """Return the fast values for one viewer."""
        now_s = self._source.now_s()
        end_s = now_s if view.end_s is None else min(view.end_s, now_s)
        start_s = end_s - view.window_s
        columns: dict[str, NDArray[Any]] = {}
        buckets: dict[str, float] = {}
        with self._signals.lock:
            for name in STRIPS:
                levels = self._signals.by_name[_TURNED.get(name, name)]
                if not math.isfinite(levels.newest_s):
                    continue
                stretch = levels.stretch(start_s, end_s, view.pixels)
                if name in _TURNED:
                    stretch = within_a_turn(replace(stretch, low=DEG * stretch.low, high=DEG * stretch.high))
                columns[f"{name}.t"] = stretch.time_s - end_s
                columns[f"{name}.low"] = stretch.low
                if stretch.bucket_s:
                    columns[f"{name}.high"] = stretch.high
                buckets[name] = stretch.bucket_s
            columns |= self._orbit(end_s)
            theta = [shown_deg(DEG * self._signals.by_name[name].last(end_s)) for name in _TURNED.values()]
            values = [self._signals.by_name[name].last(end_s) for name in ("x", "y")]
            rpm, locked = self._signals.rpm(end_s), self._signals.locked(end_s)
        predicted, why = self._predicted(rpm, locked, theta)
        shown = _nearest(predicted, theta)
        if shown is not None:
            columns["model.x"] = (shown.orbit_mm[0] * _ELLIPSE).real
            columns["model.y"] = (shown.orbit_mm[1] * _ELLIPSE).real
        header = {
            "kind": "frame",
            "number": number,
            "now_s": now_s,
            "start_s": start_s,
            "end_s": end_s,
            "buckets": buckets,
            "rpm": _number(rpm),
            "locked": locked,
            "theta": [_number(v) for v in theta],
            "last": [_number(v) for v in values],
            "predicted": [_facts(p) for p in predicted],
            "why": why,
            "ages_s": self._ages(now_s),
        }
        return encode(header, columns)

    def _orbit(self, end_s: float) -> dict[str, Array]:
        """Return x and y over the last turns, y interpolated at the times of x."""
        rpm = abs(self._signals.rpm(end_s))
        span_s = min(max(_ORBIT_TURNS * 60 / rpm if rpm > 1 else 1.0, _ORBIT_S[0]), _ORBIT_S[1])
        x_s, x = self._signals.by_name["x"].between(end_s - span_s, end_s)
        y_s, y = self._signals.by_name["y"].between(end_s - span_s, end_s)
        if len(x) < 2 or len(y) < 2:
            return {}
        every = max(1, len(x) // _ORBIT_POINTS)
        x_s, x = x_s[::-every][::-1], x[::-every][::-1]
        return {"orbit.x": x, "orbit.y": np.interp(x_s, y_s, y, np.nan, np.nan)}

    def _predicted(self, rpm: float, locked: bool | None, theta: list[float]) -> tuple[list[Predicted], str]:
        """Return the steady motions at this speed, and the reason if no motion exists."""
        if not math.isfinite(rpm):
            return [], "no device reports the speed"
        if abs(rpm) < 20:
            return [], "the rotor is at rest or nearly at rest"
        known = all(map(math.isfinite, theta))
        if locked or not known:
            angles = (math.radians(theta[0]), math.radians(theta[1])) if known else (0.0, math.pi)
            found = self._model.locked(abs(rpm), angles)
            return ([found], "") if found else ([], "no steady motion with locked pendulums")
        self._followers.wanted_rpm = rpm
        states = self._model.steady(abs(rpm))
        if states is None:
            return [], "being computed"
        return states, "" if states else "no stable steady state at this speed"

    def _ages(self, now_s: float) -> dict[str, float | None]:
        """Return the time since each channel's newest sample, s."""
        heard_s = self._source.heard_s()
        roles = self._signals.rig.roles
        topics = {d.axis: d.topic for d in roles.displacements}
        for name, role in (("angles", roles.angles), ("speed", roles.speed), ("phase", roles.phase)):
            if role is not None:
                topics[name] = role.topic
        with self._signals.lock:
            return {
                name: _number(heard_s - self._signals.topic_newest_s(topic, now_s)) for name, topic in topics.items()
            }

    def slow(self) -> bytes:
        """Return slow values: 1× vectors of the test so far and of its planned ramp, tracked damping."""
        facts = self._source.facts()
        now_s, since_s = self._source.now_s(), float(facts.get("since_s", 0.0))
        vectors = self._followers.vectors.between(since_s, now_s)
        self._followers.wanted_ramp = SpeedRamp.of(facts)
        planned = self._followers.planned
        ramp = planned[1] if planned is not None and planned[0] == self._followers.wanted_ramp else None
        vectors, lags = without_lags(vectors, ramp, clocks_of(self._signals.rig.roles))
        columns = {f"bode.{name}": vectors[:, i] for i, name in enumerate(_VECTOR)}
        if ramp is not None:
            columns |= {f"ramp.{name}": ramp[:, i] for i, name in enumerate(_VECTOR)}
        start, locked = None, list[str]()
        if self._followers.damping is not None:
            tracked = self._followers.damping.between(since_s, now_s)
            columns |= {
                f"tracked.{name}": tracked[:, i] for i, name in enumerate(("t", "c3", "c3_std", "c4", "c4_std"))
            }
            start, locked = list(self._followers.damping.start), list(self._followers.damping.locked)
        stamps = {
            axis: {"lag_ms": 1e3 * lag.lag_s, "std_ms": 1e3 * lag.std_s, "known": lag.is_line}
            for axis, lag in lags.items()
        }
        header = {
            "kind": "slow",
            "now_s": now_s,
            "since_s": since_s,
            "start": start,
            "locked": locked,
            "stamps": stamps,
        }
        return encode({**header, "trouble": self._followers.trouble}, columns)

    def curves(self) -> bytes:
        """Return constant values: the model's 1× and the limits."""
        rpm, x, y = self._model.bode()
        columns = {
            "model.rpm": rpm,
            "model.x.re": x.real,
            "model.x.im": x.imag,
            "model.y.re": y.real,
            "model.y.im": y.imag,
        }
        limits, roles = self._signals.rig.limits, self._signals.rig.roles
        header = {
            "kind": "curves",
            "model": self._model.source,
            "speed_rpm": limits.speed_rpm,
            "amplitude_mm": limits.amplitude_m * 1e3,
            "stale_s": STALE_S,
            "rig": self._signals.rig.name,
            "strips": [d.axis for d in roles.displacements]
            + (["theta3", "theta4"] if roles.angles else [])
            + (["speed"] if roles.speed or roles.phase else []),
            "turn_deg": roles.turn_deg,
        }
        return encode(header, columns)

    def state(self) -> Facts:
        """Return the state in words: limits, lamps, losses, test, events."""
        now_s, facts, events = self._source.now_s(), self._source.facts(), self._source.events()
        found = distances(self._signals, now_s, self._source.heard_s(), facts.get("disk"))
        lamps = self._lamps.look(now_s, found, events)
        plain = _plain(
            {
                **facts,
                "kind": "state",
                "now_s": now_s,
                "limits": [{**asdict(each), "used": each.used} for each in found],
                "lamps": [asdict(lamp) for lamp in lamps],
                "events": [
                    {key: event.get(key) for key in ("at_s", "kind", "device", "text")}
                    for event in events[-_EVENTS_SHOWN:]
                ],
            }
        )
        return cast("Facts", plain)


def _nearest(states: list[Predicted], theta_deg: list[float]) -> Predicted | None:
    if not states or not all(map(math.isfinite, theta_deg)):
        return states[0] if states else None
    measured = np.exp(1j * np.radians(theta_deg))
    return min(states, key=lambda s: float(np.sum(np.abs(np.exp(1j * np.radians(s.theta_deg)) - measured))))


def _facts(state: Predicted) -> Facts:
    return {
        "type": state.type,
        "theta_deg": [shown_deg(v) for v in state.theta_deg],
        "amplitude_mm": state.amplitude_mm,
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _plain(value: Any) -> Any:
    """Convert to JSON values; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in cast("Mapping[Any, Any]", value).items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in cast("list[Any]", value)]
    if isinstance(value, np.generic):
        value = cast("Any", value).item()
    return _number(value) if isinstance(value, float) else value
