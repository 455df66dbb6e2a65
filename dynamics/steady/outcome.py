"""Which steady motion a release reaches, or whether the pendulums slip for ever.

A finite run proves little by itself: pendulums may turn against the rotor hundreds of times and lock all the same. So
- a steady state is called reached when the motion has stayed near it and come nearer, rates included;
- slipping is claimed where the motion has reached a stable slipping motion (dynamics.steady.slipping);
- all else is "not settled", with the revolutions followed and what was seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynamics.arguments import check_number, check_pair
from dynamics.equations.parameters import RotorParameters, physics_of
from dynamics.equations.scene import Scene
from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import NotConverged, OutsideDomain
from dynamics.motions.integrate import locked_state, simulate
from dynamics.motions.locked_motion import damping_rates
from dynamics.steady.slipping import SlippingMotion, slipping_motion
from dynamics.steady.steady_motions import steady_states
from dynamics.steady.steady_state import SteadyState

_CHUNK = 40  # revolutions integrated at a time, fewer where they take many steps
_CHUNK_RADIANS = 20_000.0  # of the fastest oscillation
_NEAR_RAD = 5e-3  # near a stable state
_ARRIVED_RAD = 1e-4  # and so much nearer: what is left obeys the linear equations
_STAYED = 20  # revolutions it must have been near, fewer where they are longer than …
_STAYED_CONSTANTS = 10.0  # … so many time constants of the slowest damping
_CREEP_RAD = 1e-4  # in twenty revolutions: under friction, at rest
_BESIDE_RAD = math.radians(20)  # farther from a state than this friction holds the pendulums at none
_FIRST_LOOK = 120  # revolutions after which a stable slipping motion is looked for; then after twice as many, …
_LEAST_REVOLUTIONS, _TIME_CONSTANTS = 20_000, 60.0  # followed, whichever is longer, unless told otherwise …
_MOST_WORK = 2_000_000  # … and no more steps than these: about three seconds
_REFUSED_WORK = 100_000  # what a refused chunk counts as
_CHUNK_WORK = 500_000  # steps a chunk may take
_E_FOLDS = 5.0  # by which a state must be approachable, to go on
_IMPLICIT_COST = 5.0  # of an implicit step in explicit ones
_FINER = 1e-3  # accuracy of the second run, which must end where the first did
_LONG_TRANSIENT = 8000  # revolutions; beyond, one run is enough to wait for
PLAY_RAD = math.radians(0.2)


@dataclass(frozen=True)
class ReleaseOutcome:
    """Where a release ends.

    Attributes:
        state: "I", "II", "III" (or "one"), "held by friction" where dry friction keeps the pendulums at no such
            state, "slipping", or "not settled" within the revolutions followed.
        theta_rad: mean θ3, θ4 of the state reached, [0, 2π); of the last revolution when none was.
        after_s: time from the release until the motion stayed near that state; of the end when none was reached.
        revolutions: how far the motion was followed.
        slip_turns: turns of each pendulum against the rotor since the release.
        reached: the steady state, when one was reached.
        slipping: the stable slipping motion, when one was reached.
        seen: what was seen of a motion that reached nothing, in words; "" otherwise.
        from_rad: angles at which the locks held the pendulums.
        same_end: whether a run a thousand times more accurate ended in the same state and mirror image. Where it
            did not, the long transient magnifies any difference, and the end of this very release is chance.
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


def release_outcome(
    rig: RotorParameters | object,
    speed_rad_s: float,
    from_rad: tuple[float, float] = (PLAY_RAD, math.pi - 0.5 * PLAY_RAD),
    *,
    states: Sequence[SteadyState] | None = None,
    accuracy: float = 1e-6,
    most_revolutions: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> ReleaseOutcome:
    """Follow the nonlinear motion from the locked orbit until it stays with one stable motion.

    Args:
        rig: RotorParameters, or anything whose `.physics` is.
        from_rad: angles the locks hold. Exactly 0° and 180° may be an unstable rest from which nothing moves; a
            real lock has play, so the default lies 0.2° and 0.1° beside them.
        states: the steady states at this speed, when they are known already.
        accuracy: of the integration over 40 revolutions, rad, at most 1e-5.
        most_revolutions: when to give up and say "not settled"; None: 20 000 or 60 time constants of the slowest
            damping, whichever is longer, as far as two million steps go.
        progress: called with the share of the horizon done, 0 … 1.
    Raises:
        OutsideDomain: a speed, angles or limits that mean nothing.
        NotConverged: the motion can't be integrated.
    """
    p = physics_of(rig)
    check_number(speed_rad_s=speed_rad_s, accuracy=accuracy)
    check_pair(from_rad=from_rad)
    if not 0 < speed_rad_s < math.inf:
        raise OutsideDomain(f"speed: expected a finite value above 0 rad/s, got {speed_rad_s!r}")
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
    except NotConverged:  # not to be had so accurately: nothing more is known
        return first
    late = abs(second.after_s - first.after_s)
    same_time = late <= max(0.01 * first.after_s, 1.5 * 2 * math.pi / speed_rad_s)
    return replace(second, same_end=second.reached is first.reached, same_time=same_time)


def releases_within_play(
    rig: RotorParameters | object,
    speed_rad_s: float,
    play_rad: float = PLAY_RAD,
    *,
    states: Sequence[SteadyState] | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[ReleaseOutcome]:
    """Where releases end whose locks held the pendulums anywhere within a play about 0° and 180°.

    Args:
        rig, speed_rad_s, states, progress: as for release_outcome.
        play_rad: the locks' play to either side.
    Returns:
        The release that `release_outcome` takes, followed to its end; behind it one from each corner of the play,
        followed twice as far as the first had to be, where the first reached a steady state.
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
        except NotConverged:
            continue
    return found


class _Release:
    """A release on its way: the state once a revolution, and what it took to get there."""

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
        """Revolutions followed."""
        return sum(len(b) for b in self.blocks) - 1

    def follow(
        self, stable: Sequence[SteadyState], most_revolutions: int | None, progress: Callable[[float], None] | None
    ) -> ReleaseOutcome:
        """Revolution by revolution until something is reached or the horizon is."""
        rubbing, look = self.p.has_friction, _FIRST_LOOK
        since: list[int | None] = [None] * len(stable)  # from when the motion has been near each state
        most = self._horizon() if most_revolutions is None else most_revolutions
        work = _MOST_WORK if most_revolutions is None else math.inf
        while self.done < most and self.work < work:
            last = self._advance()
            for i, s in enumerate(stable):
                distance = self._distance(last, s)
                since[i] = _near_since(since[i], distance, self.done - len(last) + 1)
                begun = since[i]
                if begun is not None and distance[-1] < _ARRIVED_RAD and self.done - begun >= self.stay:
                    return self._outcome(s.type, begun, s)
            if rubbing and _at_rest(last):
                return self._held(stable)
            if not rubbing and self.done >= look:
                look *= 2
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
        """Revolutions worth following: many time constants of the slowest damping there is."""
        if not math.isfinite(self.slowest_s):
            return _LEAST_REVOLUTIONS
        return max(_LEAST_REVOLUTIONS, math.ceil(min(_TIME_CONSTANTS * self.slowest_s / self.period, 1e9)))

    def _hopeless(self, stable: Sequence[SteadyState]) -> bool:
        """Whether no stable state can be approached within the work allowed, going by its own multipliers."""
        affordable = _MOST_WORK * self.done / max(self.work, 1.0)
        return bool(stable) and _E_FOLDS * min(_time_constant(s) for s in stable) > affordable

    def _advance(self) -> NDArray[np.float64]:
        """One more chunk, its first state included, shape (chunk + 1, 8)."""
        while True:
            scene = Scene(self.history, (True, True), self.blocks[-1][-1].copy())
            try:
                motion = simulate(
                    self.p, scene, np.arange(self.chunk + 1) * self.period, self.accuracy, work_limit=_CHUNK_WORK
                )
            except NotConverged:  # neighbours separate too fast to bound the error over so many revolutions
                if self.chunk == 1:
                    raise
                self.work += _REFUSED_WORK
                self.chunk = self.chunk // 4 + (self.chunk < 4)
                continue
            break
        self.work += motion.work_steps * (_IMPLICIT_COST if motion.method == "implicit" else 1.0)
        self.blocks.append(motion.state[1:])
        return motion.state

    def _distance(self, strobe: NDArray[np.float64], s: SteadyState) -> NDArray[np.float64]:
        """Distance of strobed states (n, 8) from a state's own, angles and rates of the pendulums and the disk, rad."""
        size = 4 * max(s.amplitude_m, 0.01 * self.arm)  # the disk's displacement counts by its orbit
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
        """Pendulums that dry friction holds: at a stable state when they lie within its band."""
        last = self.blocks[-1][-1]
        rest = self._outcome("held by friction", self.done, None)
        for s in stable:
            away = np.abs(np.angle(np.exp(1j * (last[2:4] - np.array(s.theta_rad)))))
            if np.all(away <= np.minimum(1.2 * np.array(s.stick_half_width_rad), _BESIDE_RAD)):
                return replace(rest, state=s.type, reached=s)
        return rest

    def _seen(self, near: Sequence[tuple[SteadyState, int | None]]) -> str:
        """What a motion that reached nothing looked like, in words."""
        strobe = np.concatenate(self.blocks)
        half = strobe[len(strobe) // 2 :]
        said = [f"not settled within {self.done} revolutions ({self.done * self.period:.4g} s)"]
        for i in self.pendulums:
            whole = (strobe[-1, 2 + i] - strobe[0, 2 + i]) / (2 * math.pi)
            late = (half[-1, 2 + i] - half[0, 2 + i]) / (2 * math.pi)
            if abs(late) >= 1:
                rate = late / (len(half) - 1)
                said.append(f"{'AB'[i]} has made {whole:.1f} turns against the rotor, lately {rate:.3g} per revolution")
            else:
                swing = math.degrees(float(np.ptp(half[:, 2 + i])))
                said.append(f"{'AB'[i]} has not turned over lately, its angle once a revolution varied by {swing:.3g}°")
        said += [f"it was approaching {s.type} at the end" for s, begun in near if begun is not None]
        said += [] if near else ["no stable steady motion is known at this speed"]
        slowness = min((_time_constant(s) for s, _ in near), default=0.0)
        said += [f"a stable state takes {slowness:.2g} revolutions for each e-fold"] if slowness > self.done else []
        return "; ".join(said)


def _time_constant(s: SteadyState) -> float:
    """Revolutions in which a deviation from a stable state falls to 1/e."""
    modulus = float(np.abs(s.multipliers[1 if s.any_angle else 0]))
    return -1.0 / math.log(modulus) if modulus > 0 else 0.0


def _near_since(since: int | None, distance: NDArray[np.float64], first: int) -> int | None:
    """The revolution from which the motion has stayed near a state; None when it is not near at the end."""
    far = np.flatnonzero(~(distance < _NEAR_RAD))
    if len(far) == 0:
        return first if since is None else since
    return None if far[-1] == len(distance) - 1 else first + int(far[-1]) + 1


def _at_rest(strobe: NDArray[np.float64]) -> bool:
    """Whether dry friction has all but stopped the pendulums: what is left is creep under the torque's ripple."""
    late = strobe[len(strobe) // 2 :]
    return bool(np.ptp(late[:, 2:4], axis=0).max() < _CREEP_RAD and np.ptp(late[:, :2], axis=0).max() < 1e-6)
