"""The steady motion that a release reaches, or permanent slipping of the pendulums.

A finite run is not a proof: pendulums may turn relative to the rotor hundreds of times and then lock. Therefore
- a steady state counts as reached if the motion has stayed near it and approached it, rates included;
- slipping is reported if the motion has reached a stable slipping motion (dynamics.steady.slipping);
- every other result is "not settled", with the simulated revolutions and a description of the motion.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynamics.arguments import check_number, check_pair, check_speed
from dynamics.arrays import Array
from dynamics.equations.parameters import RigOrParameters, RotorParameters, physics_of
from dynamics.equations.scene import Scene
from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import NotConverged, OutsideDomain
from dynamics.motions.integrate import locked_state, simulate
from dynamics.motions.locked_motion import damping_rates
from dynamics.steady.slipping import SlippingMotion, slipping_motion
from dynamics.steady.steady_motions import steady_states
from dynamics.steady.steady_state import SteadyState
from rig_basics.tabular import Column, Tabular
from rig_basics.texts import number_of

_log = logging.getLogger(__name__)

_CHUNK = 40  # revolutions simulated at a time, fewer if they need many steps
_CHUNK_RADIANS = 20_000.0  # of the fastest oscillation
_NEAR_RAD = 5e-3  # distance below which a motion is near a stable state
_ARRIVED_RAD = 1e-4  # distance below which the linear equations describe the deviation
_STAYED = 20  # revolutions for which it must have been near, fewer if they are longer than …
_STAYED_CONSTANTS = 10.0  # … this number of time constants of the slowest damping
_CREEP_RAD = 1e-4  # change in twenty revolutions below which a pendulum with friction is at rest
_MAX_HELD_RAD = math.radians(20)  # largest distance from a state at which friction holds the pendulums at it
_FIRST_CHECK = 120  # revolutions after which slipping is checked first; then after twice as many, …
_MIN_HORIZON, _TIME_CONSTANTS = 20_000, 60.0  # default horizon: revolutions or time constants, whichever is longer …
_MAX_WORK = 2_000_000  # … and at most this number of steps: about three seconds
_REFUSED_WORK = 100_000  # work attributed to a failed chunk, in steps
_CHUNK_WORK = 500_000  # largest number of steps of a chunk
_E_FOLDS = 5.0  # of the approach to a state that must be affordable
_IMPLICIT_COST = 5.0  # cost of an implicit step in explicit steps
_FINER = 1e-3  # relative accuracy of the second run, which must have the same end
_LONG_TRANSIENT = 8000  # revolutions above which the second run is omitted
PLAY_RAD = math.radians(0.2)


@dataclass(frozen=True)
class ReleaseOutcome(Tabular):
    """End of a release.

    Attributes:
        state: "I", "II", "III" (or "one"), "held by friction" if dry friction holds the pendulums away from such a
            state, "slipping", or "not settled" within the simulated revolutions.
        theta_rad: mean θ3, θ4 of the state reached, [0, 2π); of the last revolution if none was reached.
        after_s: time from the release until the motion stayed near that state, s; until the end if none was reached.
        revolutions: number of simulated revolutions.
        slip_turns: turns of each pendulum relative to the rotor since the release.
        reached: the steady state reached, or None.
        slipping: the stable slipping motion reached, or None.
        seen: description of a motion without an end; otherwise "".
        from_rad: angles of the pendulums at the release.
        same_end: whether a run a thousand times more accurate ended in the same state and mirror image. If it did not,
            the long transient amplifies any difference, and the end of this release is not determined.
        same_time: whether it arrived at the same time, to a revolution or a hundredth.
    """

    state: str
    theta_rad: tuple[float, float]
    after_s: float
    revolutions: int
    slip_turns: tuple[float, float]
    reached: SteadyState | None
    slipping: SlippingMotion | None = None
    seen: str = ""
    from_rad: tuple[float, float] = (0.0, math.pi)
    same_end: bool = True
    same_time: bool = True

    @property
    def heading(self) -> str:
        """State and duration."""
        return f"ReleaseOutcome: {self.state} after {self.after_s:.4g} s"

    @property
    def remarks(self) -> Sequence[str]:
        """What limits the result."""
        doubt = [] if self.same_end else ["a more accurate run ended in another state: the end is not determined"]
        return [*([self.seen] if self.seen else []), *doubt]

    def columns(self) -> Mapping[str, Column]:
        """Return a row for each pendulum."""
        pairs = {"from_rad": self.from_rad, "theta_rad": self.theta_rad, "slip_turns": self.slip_turns}
        return {"pendulum": ["A", "B"], **pairs}


def release_outcome(
    rig: RigOrParameters,
    speed_rad_s: float,
    from_rad: tuple[float, float] = (PLAY_RAD, math.pi - 0.5 * PLAY_RAD),
    *,
    states: Sequence[SteadyState] | None = None,
    accuracy: float = 1e-6,
    most_revolutions: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> ReleaseOutcome:
    """Simulate a release from the locked orbit until the motion stays with one stable motion.

    Args:
        rig: RotorParameters, or an object whose `.physics` is one.
        from_rad: angles of the pendulums at the release. Exactly 0° and 180° may be an unstable rest position. A real
            lock has play, so the defaults differ from these by 0.2° and 0.1°.
        states: the steady states at this speed, if they are known.
        accuracy: accuracy of the integration over 40 revolutions, rad, at most 1e-5.
        most_revolutions: number of revolutions after which the result is "not settled". None: 20 000 or 60 time
            constants of the slowest damping, whichever is longer, but at most two million steps.
        progress: called with the completed share of the horizon, 0 … 1.
    Raises:
        OutsideDomain: invalid speed, angles or limits.
        NotConverged: the motion cannot be integrated.
    """
    p = physics_of(rig)
    check_number(accuracy=accuracy)
    check_pair(from_rad=from_rad)
    check_speed(speed_rad_s, p.natural_frequencies_rad_s)
    if not (0 < accuracy <= 1e-5):
        raise OutsideDomain(f"accuracy of a release must be above 0 and at most 1e-5 rad, got {accuracy!r}")
    if most_revolutions is not None and most_revolutions < 1:
        raise OutsideDomain(f"most_revolutions must be at least 1, got {most_revolutions!r}")
    if not (p.a.present or p.b.present):
        raise OutsideDomain("a release needs a pendulum: both masses are 0")
    known = steady_states(p, speed_rad_s, 1e-6) if states is None else states
    stable = [s for s in known if s.draws]
    first = _Release(p, speed_rad_s, from_rad, accuracy).follow(stable, most_revolutions, progress)
    if first.reached is None or first.revolutions > _LONG_TRANSIENT or p.has_friction:
        return first
    try:
        second = _Release(p, speed_rad_s, from_rad, max(_FINER * accuracy, 1e-11)).follow(
            stable, 2 * first.revolutions + 10 * _CHUNK, None
        )
    except NotConverged as error:
        _log.info(
            "release from %s at %.6g rad/s: the end is not confirmed by a second run: %s", from_rad, speed_rad_s, error
        )
        return first
    late = abs(second.after_s - first.after_s)
    same_time = late <= max(0.01 * first.after_s, 1.5 * 2 * math.pi / speed_rad_s)
    return replace(second, same_end=second.reached is first.reached, same_time=same_time)


def releases_within_play(
    rig: RigOrParameters,
    speed_rad_s: float,
    play_rad: float = PLAY_RAD,
    *,
    states: Sequence[SteadyState] | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[ReleaseOutcome]:
    """Simulate releases for several positions within a play of the locks about 0° and 180°.

    Args:
        rig, speed_rad_s, states, progress: as for release_outcome.
        play_rad: play of the locks to either side, rad.
    Returns:
        The default release of `release_outcome`, simulated to its end. If it reached a steady state, it is followed by
        one release from each corner of the play, simulated for twice as many revolutions.
    Raises:
        OutsideDomain, NotConverged: as release_outcome.
    """
    p = physics_of(rig)
    known = steady_states(p, speed_rad_s, 1e-6) if states is None else states
    first = release_outcome(p, speed_rad_s, (play_rad, math.pi - 0.5 * play_rad), states=known, progress=progress)
    found = [first]
    if first.reached is None or first.revolutions > _LONG_TRANSIENT:
        return found
    stable = [s for s in known if s.draws]
    for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        start = (a * play_rad, math.pi + b * play_rad)
        try:
            found.append(_Release(p, speed_rad_s, start, 1e-6).follow(stable, 2 * first.revolutions + 400, None))
        except NotConverged as error:
            _log.warning("release from %s at %.6g rad/s is left out: %s", start, speed_rad_s, error)
    return found


class _Release:
    """A release during its simulation: the state once a revolution, and the work so far."""

    def __init__(
        self, parameters: RotorParameters, speed: float, from_rad: tuple[float, float], accuracy: float
    ) -> None:
        self.p, self.speed, self.accuracy = parameters, speed, accuracy
        self.from_rad = (float(from_rad[0]), float(from_rad[1]))
        self.period = 2 * math.pi / speed
        self.history = SpeedHistory.constant(speed)
        self.blocks = [locked_state(parameters, speed, 0.0, *from_rad)[None, :]]  # the state once a revolution
        self.work = 0.0
        fastest = max(speed, *parameters.natural_frequencies_rad_s)
        self.chunk = max(1, min(_CHUNK, int(_CHUNK_RADIANS / (fastest * self.period))))
        rates = [r for r in damping_rates(parameters) if r > 0]
        self.slowest_s = 1.0 / min(rates) if rates else math.inf
        self.stay = max(1, math.ceil(min(_STAYED, _STAYED_CONSTANTS * self.slowest_s / self.period)))
        self.pendulums = [i for i, q in enumerate((parameters.a, parameters.b)) if q.present]
        lengths = (parameters.a.length_m, parameters.b.length_m)
        self.arm = max(lengths[i] for i in self.pendulums)

    @property
    def done(self) -> int:
        """Number of simulated revolutions."""
        return sum(len(b) for b in self.blocks) - 1

    def follow(
        self, stable: Sequence[SteadyState], most_revolutions: int | None, progress: Callable[[float], None] | None
    ) -> ReleaseOutcome:
        """Simulate revolutions until a motion is reached or the horizon ends."""
        has_friction, next_check = self.p.has_friction, _FIRST_CHECK
        since: list[int | None] = [None] * len(stable)  # revolution from which the motion has been near each state
        most = self._horizon() if most_revolutions is None else most_revolutions
        work = _MAX_WORK if most_revolutions is None else math.inf
        while self.done < most and self.work < work:
            last = self._advance()
            for i, s in enumerate(stable):
                distance = self._distance(last, s)
                since[i] = _near_since(since[i], distance, self.done - len(last) + 1)
                begun = since[i]
                if begun is not None and distance[-1] < _ARRIVED_RAD and self.done - begun >= self.stay:
                    return self._outcome(s.type, begun, s)
            if has_friction and _at_rest(last):
                return self._held(stable)
            if not has_friction and self.done >= next_check:
                next_check *= 2
                strobe = np.concatenate(self.blocks)
                slipping = slipping_motion(self.p, self.speed, strobe[len(strobe) // 2 :])
                if slipping is not None:
                    return replace(self._outcome("slipping", self.done, None), slipping=slipping)
            if most_revolutions is None and self._hopeless(stable):
                break
            if progress is not None:
                progress(min(1.0, max(self.done / most, self.work / work)))
        near = [(s, since[i]) for i, s in enumerate(stable)]
        return replace(self._outcome("not settled", self.done, None), seen=self._seen(near))

    def _horizon(self) -> int:
        """Default number of revolutions: many time constants of the slowest damping."""
        if not math.isfinite(self.slowest_s):
            return _MIN_HORIZON
        return max(_MIN_HORIZON, math.ceil(min(_TIME_CONSTANTS * self.slowest_s / self.period, 1e9)))

    def _hopeless(self, stable: Sequence[SteadyState]) -> bool:
        """Whether, by their multipliers, no stable state can be approached within the permitted work."""
        affordable = _MAX_WORK * self.done / max(self.work, 1.0)
        return bool(stable) and _E_FOLDS * min(_time_constant(s) for s in stable) > affordable

    def _advance(self) -> Array:
        """Simulate one more chunk; its states with the first one included, shape (chunk + 1, 8)."""
        while True:
            scene = Scene(self.history, (True, True), self.blocks[-1][-1].copy())
            try:
                motion = simulate(
                    self.p, scene, np.arange(self.chunk + 1) * self.period, self.accuracy, work_limit=_CHUNK_WORK
                )
            except NotConverged:  # neighbours diverge too fast to bound the error over so many revolutions
                if self.chunk == 1:
                    raise
                self.work += _REFUSED_WORK
                self.chunk = self.chunk // 4 + (self.chunk < 4)
                continue
            break
        self.work += motion.work_steps * (_IMPLICIT_COST if motion.method == "implicit" else 1.0)
        self.blocks.append(motion.state[1:])
        return motion.state

    def _distance(self, strobe: Array, s: SteadyState) -> Array:
        """Distance of strobed states (n, 8) from a state, over angles and rates of pendulums and disk, rad."""
        size = 4 * max(s.amplitude_m, 0.01 * self.arm)  # scale of the disk's displacement, from its orbit
        scale = np.array([size, size, 1.0, 1.0, size * self.speed, size * self.speed, self.speed, self.speed])
        gap = np.abs(strobe - s.start) / scale
        gap[:, 2:4] = np.abs(np.exp(1j * strobe[:, 2:4]) - np.exp(1j * s.start[2:4]))
        if s.any_angle:
            opening = np.exp(1j * (strobe[:, 2] - strobe[:, 3])) - np.exp(1j * (s.start[2] - s.start[3]))
            gap[:, 2:4] = np.abs(opening)[:, None]
        absent = [i for i in (0, 1) if i not in self.pendulums]
        gap[:, [c for i in absent for c in (2 + i, 6 + i)]] = 0.0
        return gap.max(axis=1)

    def _outcome(self, name: str, after: int, reached: SteadyState | None) -> ReleaseOutcome:
        first, last = self.blocks[0][0], self.blocks[-1][-1]
        turns = (last[2:4] - first[2:4]) / (2 * math.pi)
        theta = last[2:4] % (2 * math.pi)
        free = reached is None or reached.any_angle
        own = (float(theta[0]), float(theta[1])) if free or reached is None else reached.theta_rad
        slip = (float(turns[0]), float(turns[1]))
        return ReleaseOutcome(name, own, after * self.period, self.done, slip, reached, from_rad=self.from_rad)

    def _held(self, stable: Sequence[SteadyState]) -> ReleaseOutcome:
        """Outcome of pendulums held by dry friction; at a stable state if they lie within its band."""
        last = self.blocks[-1][-1]
        rest = self._outcome("held by friction", self.done, None)
        for s in stable:
            away = np.abs(np.angle(np.exp(1j * (last[2:4] - np.array(s.theta_rad)))))
            if np.all(away <= np.minimum(1.2 * np.array(s.stick_half_width_rad), _MAX_HELD_RAD)):
                return replace(rest, state=s.type, reached=s)
        return rest

    def _seen(self, near: Sequence[tuple[SteadyState, int | None]]) -> str:
        """Description of a motion that reached nothing."""
        strobe = np.concatenate(self.blocks)
        half = strobe[len(strobe) // 2 :]
        sentences = [f"not settled within {number_of(self.done, 'revolution')} ({self.done * self.period:.4g} s)"]
        for i in self.pendulums:
            whole = (strobe[-1, 2 + i] - strobe[0, 2 + i]) / (2 * math.pi)
            late = (half[-1, 2 + i] - half[0, 2 + i]) / (2 * math.pi)
            if abs(late) >= 1:
                rate = late / (len(half) - 1)
                sentences.append(
                    f"{'AB'[i]} has made {whole:.1f} turns against the rotor, lately {rate:.3g} per revolution"
                )
            else:
                swing = math.degrees(float(np.ptp(half[:, 2 + i])))
                sentences.append(
                    f"{'AB'[i]} has not turned over lately, its angle once a revolution varied by {swing:.3g}°"
                )
        sentences += [f"it was approaching {s.type} at the end" for s, begun in near if begun is not None]
        sentences += [] if near else ["no stable steady motion is known at this speed"]
        slowness = min((_time_constant(s) for s, _ in near), default=0.0)
        if slowness > self.done:
            sentences.append(f"a stable state takes {slowness:.2g} revolutions for each e-fold")
        return "; ".join(sentences)


def _time_constant(s: SteadyState) -> float:
    """Number of revolutions in which a deviation from a stable state decreases to 1/e."""
    modulus = float(np.abs(s.multipliers[1 if s.any_angle else 0]))
    return -1.0 / math.log(modulus) if modulus > 0 else 0.0


def _near_since(since: int | None, distance: Array, first: int) -> int | None:
    """Revolution from which the motion has stayed near a state; None if it is not near at the end."""
    far = np.flatnonzero(~(distance < _NEAR_RAD))
    if len(far) == 0:
        return first if since is None else since
    return None if far[-1] == len(distance) - 1 else first + int(far[-1]) + 1


def _at_rest(strobe: Array) -> bool:
    """Whether dry friction has stopped the pendulums except for creep due to the torque's pulsation."""
    late = strobe[len(strobe) // 2 :]
    return bool(np.ptp(late[:, 2:4], axis=0).max() < _CREEP_RAD and np.ptp(late[:, :2], axis=0).max() < 1e-6)
