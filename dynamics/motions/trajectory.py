"""One run at one tolerance: smooth pieces of motion between releases and mode changes of dry friction."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dynamics.arrays import Array
from dynamics.equations.friction import BACKWARD, FORWARD, STUCK, Modes, modes_at, with_modes
from dynamics.equations.kernels import FA
from dynamics.equations.phase_segments import PhaseSegments
from dynamics.errors import NotConverged
from dynamics.motions.marching import (
    MODE_ENDS_A,
    MODE_ENDS_B,
    REACHED,
    STEP_TOO_SMALL,
    STEPS_SPENT,
    UNWATCHED,
    WATCH_BACKWARD,
    WATCH_FORWARD,
    WATCH_STUCK,
    march,
)
from dynamics.motions.motion import MotionEvent, Piece, Polynomials
from rig_basics.texts import number_of

_WATCH = {FORWARD: WATCH_FORWARD, BACKWARD: WATCH_BACKWARD, STUCK: WATCH_STUCK}
_EVENT = {FORWARD: "slide forward", BACKWARD: "slide backward", STUCK: "stick"}
_STEPS_PER_CALL = 100_000  # compiled code returns after this number of steps, so that interrupts are processed
_MAX_SWITCHES_AT_ONCE = 30
_MAX_EXPECTED_RATIO = 3.0  # of expected to permitted steps; the prediction is accurate to a factor of a few
_SWITCH_STEPS = 10  # cost of a mode change, in steps


@dataclass(frozen=True)
class Problem:
    """Input of a run, in the layout of compiled code.

    Attributes:
        start: start state, shape (8,).
        times: output instants, shape (n,), ascending. The run begins at the first and ends at the last.
        packed: parameters (RotorParameters.packed), shape (26,).
        segments: the rotor's phase.
        free_from: instants from which A and B are free, s; inf for a locked pendulum.
        weights: scales of the components' errors, shape (8,) (one for angles).
        pace: fastest rate that must be resolved, 1/s.
        longest_step_s: longest permitted step, s.
    """

    start: Array
    times: Array
    packed: Array
    segments: PhaseSegments
    free_from: tuple[float, float]
    weights: Array
    pace: float
    longest_step_s: float = np.inf

    @property
    def has_friction(self) -> bool:
        """Whether a pendulum that is released during the run has dry friction."""
        return any(self.packed[FA + i] != 0.0 and np.isfinite(self.free_from[i]) for i in range(2))


@dataclass
class Trajectory:
    """Result of a run. `polynomials` is None unless they were requested."""

    states: Array
    steps: int = 0
    tried: int = 0
    events: list[MotionEvent] = field(default_factory=list[MotionEvent])
    polynomials: Polynomials | None = None


def run(problem: Problem, tolerance: float, implicit: bool, most_steps: int, keep: bool = False) -> Trajectory:
    """Compute the motion at one tolerance per step.

    Raises:
        NotConverged: the run needs more than most_steps steps, a step becomes too small, or friction changes modes
            without end.
    """
    return _Run(problem, tolerance, implicit, most_steps, keep).result()


class _Run:
    """State of a run between calls of the compiled march."""

    def __init__(self, problem: Problem, tolerance: float, implicit: bool, most_steps: int, keep: bool) -> None:
        self.problem, self.tolerance, self.implicit = problem, tolerance, implicit
        self.most_steps, self.keep = most_steps, keep
        self.y, self.t = problem.start.copy(), float(problem.times[0])
        self.h, self.done = 0.1 / problem.pace, 0
        self.out = Trajectory(np.empty((len(problem.times), 8)))
        self.kept: list[tuple[Array, Array]] = []
        self.pieces: list[Piece] = []
        self.switches_at, self.switches = self.t, 0

    def result(self) -> Trajectory:
        problem, end = self.problem, float(self.problem.times[-1])
        for i, at in enumerate(problem.free_from):
            if not at <= self.t:
                self.y[6 + i] = 0.0
        while self.done < len(problem.times) and problem.times[self.done] <= self.t:
            self.out.states[self.done] = self.y
            self.done += 1
        while self.t < end:
            free = problem.free_from[0] <= self.t, problem.free_from[1] <= self.t
            later = [at for at in problem.free_from if self.t < at < end]
            self._stretch(free, min([end, *later]))
            self.out.events.extend(
                MotionEvent(self.t, "release", i) for i, at in enumerate(problem.free_from) if at == self.t < end
            )
        if self.keep:
            spans, polynomials = (np.concatenate(parts) for parts in zip(*self.kept, strict=True))
            self.out.polynomials = Polynomials(spans, polynomials, end, tuple(self.pieces))
        return self.out

    def _stretch(self, free: tuple[bool, bool], limit: float) -> None:
        """Integrate to a limit with the same free pendulums, through all mode changes of friction."""
        p = self.problem.packed
        modes = self._modes(free)
        has_friction = tuple(free[i] and p[FA + i] != 0.0 for i in range(2))
        while True:
            packed, free_a, free_b = with_modes(p, modes, free)
            watch = tuple(_WATCH[modes[i]] if has_friction[i] else UNWATCHED for i in range(2))
            ended = self._march(packed, free_a, free_b, (watch[0], watch[1]), limit)
            if ended == REACHED:
                return
            i = ended - MODE_ENDS_A
            self.y[6 + i] = 0.0
            self._count_switch()
            new = self._modes(free, i if modes[i] == STUCK else None)
            self.out.events.extend(
                MotionEvent(self.t, _EVENT[new[j]], j) for j in range(2) if has_friction[j] and new[j] != modes[j]
            )
            modes = new
            if self.t >= limit:
                return

    def _modes(self, free: tuple[bool, bool], leaving: int | None = None) -> Modes:
        return modes_at(self.y, self.problem.segments.phase(self.t), self.problem.packed, free, leaving)

    def _count_switch(self) -> None:
        """Count a mode change.

        Raises:
            NotConverged: modes change repeatedly in almost no time.
        """
        if self.t - self.switches_at > 1e-6 / self.problem.pace:
            self.switches_at, self.switches = self.t, 0
        self.switches += 1
        self.out.tried += _SWITCH_STEPS
        self.h = min(self.h, 0.05 / self.problem.pace)
        if self.switches > _MAX_SWITCHES_AT_ONCE:
            raise NotConverged(
                f"dry friction changed modes {number_of(self.switches, 'time')} around t = {self.t:.9g} s "
                f"without time passing; "
                "start from a slightly different state or change the friction slightly"
            )

    def _march(self, packed: Array, free_a: float, free_b: float, watch: tuple[int, int], limit: float) -> int:
        problem, out = self.problem, self.out
        s = problem.segments
        system = (packed, free_a, free_b, s.knots, s.origins, s.cubics)
        first = out.steps
        while True:
            room = max(64, min(2 * out.steps, _STEPS_PER_CALL // 10)) if self.keep else 0
            store = np.empty((room, 2)), np.empty((room, 8, 8))
            most = min(_STEPS_PER_CALL, self.most_steps - out.tried)
            ended, self.t, self.h, self.done, accepted, tried = march(
                self.y,
                self.t,
                limit,
                self.h,
                1 if self.implicit else None,
                self.tolerance,
                problem.weights,
                system,
                s.jumps,
                problem.longest_step_s,
                watch,
                problem.times,
                self.done,
                out.states,
                store,
                most,
            )
            if self.keep and accepted:
                self.kept.append((store[0][:accepted], store[1][:accepted]))
            out.steps += accepted
            out.tried += tried
            if ended == STEP_TOO_SMALL:
                raise NotConverged(
                    f"the step became too small at t = {self.t:.9g} s (tolerance {self.tolerance:.2g} per step): the "
                    "motion is unbounded there or the accuracy is beyond double precision"
                )
            if ended == STEPS_SPENT and (
                out.tried >= self.most_steps or self._expected() > _MAX_EXPECTED_RATIO * self.most_steps
            ):
                raise NotConverged(self._spent())
            if ended in (REACHED, MODE_ENDS_A, MODE_ENDS_B):
                self.pieces.append(Piece(first, out.steps, packed, free_a, free_b))
                return ended

    def _expected(self) -> float:
        """Expected number of steps of the whole run, from the steps so far."""
        times = self.problem.times
        return self.out.tried * (times[-1] - times[0]) / max(self.t - times[0], np.finfo(float).tiny)

    def _spent(self) -> str:
        times = self.problem.times
        return (
            f"{number_of(self.out.tried, 'step')} brought the motion from t = {times[0]:.6g} to {self.t:.6g} "
            f"of {times[-1]:.6g} s "
            f"(about {self._expected():.2g} steps for the whole, {self.most_steps:.2g} allowed); raise work_limit, "
            "reduce the accuracy or shorten the run"
        )
