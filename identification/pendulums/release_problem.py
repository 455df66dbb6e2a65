"""Least-squares problem of a release: unknowns, prior knowledge, encoder readings and derivatives.

θ = (ln c3, ln c4, θ3, θ4 at release, two encoder zeros, instant at which lock A opens, the disk's deviation x, y, ẋ, ẏ
from its locked orbit, ln k1, ln k2, ln ζ1, ln ζ2, ln S_P, instant at which lock B opens). Instants count from the mean
of both messages. With dry friction follow its torques on A and B at the rotor's speed (for the shape "both" first those
of "torque", then those of "contact"). Then follow the errors of the recorded phase, and the errors of the pendulums'
masses and lengths if these are free.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from daq.signals.phase_noise import encoder_step
from daq.signals.run import Run
from dynamics.equations.parameters import RotorParameters
from dynamics.errors import OutsideDomain
from identification.errors import NotIdentifiable
from identification.least_squares import Minimum
from identification.locked_pendulums import loose_locks
from identification.pendulums.free_angles import both_angles, laid_over, log_suspension, swing
from identification.pendulums.friction import Evidence, Friction, evidence
from identification.pendulums.known_numbers import answer_to, by_physical_numbers
from identification.pendulums.locked_start import LockedStart
from identification.pendulums.open_friction import CONTACT_STD_kg_m2, OpenFriction, TORQUE_STD_Nm
from identification.pendulums.open_numbers import PENDULUMS, with_open_numbers
from identification.pendulums.opening_locks import Opening, opened_locks
from identification.pendulums.recorded_speed import RecordedSpeed, recorded_speed
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import EncoderReadings, OpenedFit, TransientProblem
from identification.pendulums.unknown_phase import TURN_STD_RAD, with_phase
from identification.samples import Averages, block_averages, encoder_noise
from identification.setting import Setting
from rig_basics.arrays import Array
from rig_basics.texts import distinct, number_of
from rig_configs.known import INDEX, ZERO_A, ZERO_B

Shape = Literal["torque", "contact", "both"]
"""Shape of dry friction: torque independent of the speed, torque proportional to the contact force, or both."""

SUSPENSION, OPENS, _BASE = slice(11, 16), (6, 16), 17
TORQUES = (_BASE, _BASE + 1)
"""Indices of the friction torques of A and B in θ of one shape of dry friction."""
OWN_START = (*range(2, 11), 16)
"""Indices in θ of the start of the motion: angles, zeros, the disk's deviation and the instants."""
_START, _ZEROS, _DISK = slice(2, 4), slice(4, 6), slice(7, 11)
_LATE_STD_S = 0.02  # largest prior standard deviation of the instants at which locks open; a rig file allows no larger
_OPENING_STDS = 4.0  # standard deviations about its message within which a lock opens
_SHORTEST_STD_S = 1e-6  # prior standard deviation of an instant that is known exactly
_LOCKED_S = 0.02  # time before the messages in which a lock may already move
_MAX_TIME_STD_S = 0.03  # standard uncertainty of the instant of release above which the damping would be biased
_BLOCK_S = {"fast": 0.004, "balanced": 0.004, "reference": 0.001}
_DISK_STD_M = 2e-5
_EXACT_RAD, _TURN_RAD = 1e-7, 1e-5  # standard deviation of exact zeros; step of the index angle
_LONGEST_S, _AFTER_SETTLING_S, _MEMORY_S = 25.0, 0.5, 12.0
_DAMPING_STD = 2.5  # prior of ln c: a start value wrong by a factor of 100 is within two standard deviations
_DAMPING_WITH_FRICTION_STD = 0.7  # the same with dry friction, which could otherwise replace the viscous damping


@dataclass(frozen=True)
class RecordedRelease:
    """One recorded release.

    Attributes:
        run: recording.
        knowledge: masses, lengths, prior knowledge of the suspension, and start values of damping.
        rest: locked rig before the release.
        speed: rotor phase and its uncertainty.
        begin_s: start of the fitted readings, s.
        message_s: instants of the messages that A and B are released, minus `rest.release_s`, s, shape (2,).
        opening_std_s: prior standard deviation of the instants at which the locks open, s, shape (2,).
        expected_std_s: standard uncertainty of these instants by rig file and messages, s, shape (2,).
        readings: readings of both encoders from `begin_s` on.
        locked_rad: mean readings of the locked pendulums, rad, shape (2,).
        zero_std_rad: standard uncertainty of the encoders' zeros, rad.
        number_std: free known number → its standard uncertainty.
    """

    run: Run
    knowledge: Knowledge
    rest: LockedStart
    speed: RecordedSpeed
    begin_s: float
    message_s: np.ndarray
    opening_std_s: np.ndarray
    expected_std_s: np.ndarray
    readings: tuple[EncoderReadings, EncoderReadings]
    locked_rad: np.ndarray
    zero_std_rad: float
    number_std: Mapping[str, float] = field(default_factory=dict[str, float])

    @classmethod
    def of(
        cls,
        run: Run,
        knowledge: Knowledge,
        zero_std_rad: float,
        setting: Setting,
        least_opening_std_s: float = _SHORTEST_STD_S,
    ) -> RecordedRelease:
        """Create the release from a run.

        Args:
            run: recording.
            knowledge: prior knowledge of the other parameters.
            zero_std_rad: standard uncertainty of the encoders' zeros, rad.
            setting: length of the blocks of readings.
            least_opening_std_s: smallest prior standard deviation of the instants at which the locks open, s.
        Raises:
            NotIdentifiable: there are no releases, or too few marks or samples.
        """
        messages, expected = _release_times(run, knowledge.release_std_s)
        std = np.maximum(expected, least_opening_std_s)
        go, reach = float(np.mean(messages)), _OPENING_STDS * float(np.max(std))
        rest, speed = _locked_start(run, go)
        begin = float(np.max(messages)) + max(_BLOCK_S["balanced"], reach)
        readings = _readings(run, begin, _BLOCK_S[setting])
        sure = float(np.min(messages)) - max(_LOCKED_S, reach)
        if loose := loose_locks(run, sure):
            raise NotIdentifiable(f"{run.source}: {'; '.join(each.sentence for each in loose)}")
        before = (run.angle_time_s < sure) & (run.angle_time_s > sure - 2.0)
        if np.count_nonzero(before) < 100:
            raise NotIdentifiable(f"{run.source}: no encoder samples of the locked pendulums before the release")
        locked = np.nanmean(run.angle_rad[before], axis=0)
        return cls(run, knowledge, rest, speed, begin, messages - go, std, expected, readings, locked, zero_std_rad)

    def with_late_locks(self, setting: Setting) -> RecordedRelease:
        """Return the release with a prior of the locks' instants that is wider than that of any rig file."""
        return RecordedRelease.of(self.run, self.knowledge, self.zero_std_rad, setting, _LATE_STD_S)

    @property
    def speed_rad_s(self) -> float:
        """Rotor speed at the release, rad/s."""
        return self.rest.speed_rad_s

    @property
    def moved_rad(self) -> np.ndarray:
        """Range of each pendulum's angle after the release, without the encoders' flicker, rad, shape (2,)."""
        ranges = [np.quantile(r.averages.value, [0.005, 0.995]) for r in self.readings]
        return np.array([float(high - low) for low, high in ranges])

    @property
    def start(self) -> np.ndarray:
        """Start value of θ without friction and phase, shape (17,)."""
        physics = self.knowledge.physics
        damping = np.log([physics.a.damping_Nms_per_rad, physics.b.damping_Nms_per_rad])
        theta = np.r_[damping, self.locked_rad, np.zeros(7), log_suspension(physics), 0.0]
        theta[list(OPENS)] = self.message_s
        return theta

    @property
    def _zero_std(self) -> float:
        """Standard deviation of the encoders' zeros, with a negligible value for exact ones, rad."""
        return max(self.zero_std_rad, _EXACT_RAD)

    @property
    def open_phase(self) -> int:
        """Number of unknowns of the phase in θ."""
        return len(self.speed.modes) + int(not self.run.phase_absolute)

    def problem(self, shape: Shape | None = None) -> TransientProblem:
        """Return the least-squares problem with dry friction of a shape, or without for None."""
        start, omega = self.start, self.knowledge.physics.natural_frequencies_rad_s[0]
        # start angles are locked angles minus zeros; the mean of quantised readings at rest has an error of step/√12
        angle_std = max(max(r.step_rad for r in self.readings) / np.sqrt(12), 1e-5)
        damping_std = _DAMPING_STD if shape is None else _DAMPING_WITH_FRICTION_STD
        std = np.r_[
            damping_std,
            damping_std,
            angle_std,
            angle_std,
            self._zero_std,
            self._zero_std,
            self.opening_std_s[0],
            _DISK_STD_M,
            _DISK_STD_M,
            _DISK_STD_M * omega,
            _DISK_STD_M * omega,
            self.knowledge.log_std,
            self.opening_std_s[1],
        ]
        dry, modes, turn = _unknowns(shape), len(self.speed.modes), not self.run.phase_absolute
        prior = np.r_[start, np.zeros(dry + modes + int(turn))]
        std = np.r_[std, np.full(dry, np.inf), np.ones(modes), np.full(int(turn), TURN_STD_RAD)]

        def predict(theta: np.ndarray, end_s: float, phase: np.ndarray, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
            return self.angles(theta, problem.cut(end_s), phase, shape, slopes)

        problem = TransientProblem(self.readings, with_phase(predict, start[:2], modes, turn), prior, std)
        if not self.number_std:
            return problem

        def made(knowledge: Knowledge) -> TransientProblem:
            return replace(self, knowledge=knowledge, number_std={}).problem(shape)

        return with_open_numbers(problem, self.knowledge, self.number_std, SUSPENSION, made)

    def angles(
        self,
        theta: np.ndarray,
        cut: tuple[Averages, Averages],
        phase: np.ndarray,
        shape: Shape | None,
        slopes: bool = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return readings of both encoders and derivatives; the true start angles are those of θ minus the zeros."""
        count, size = sum(len(c.time_s) for c in cut), len(theta)
        bad = np.full(count, np.nan), np.zeros((count, size))
        if not np.all(np.isfinite(theta)) or np.max(np.abs(theta[[0, 1, *range(11, 16)]])) > 40:
            return bad
        rest = self.rest.along(self.speed.moved(phase)) if np.any(phase) else self.rest
        try:
            now = laid_over(self.knowledge, theta[:2], theta[SUSPENSION])
        except OutsideDomain:  # usual: a trial with impossible parameters
            return bad

        def physics_of(log_change: np.ndarray) -> RotorParameters:
            if not np.any(log_change):
                return now
            return laid_over(self.knowledge, theta[:2] + log_change[:2], theta[SUSPENSION] + log_change[2:])

        true, instants = theta[_START] - theta[_ZEROS], theta[list(OPENS)]
        if not np.max(np.abs(instants)) < self.begin_s - rest.release_s:
            return bad
        opened = opened_locks(rest, physics_of, (true[0], true[1]), (instants[0], instants[1]), theta[_DISK])
        if opened is None:
            return bad
        last = max(float(c.time_s[-1]) for c in cut)
        dry, dry_by = self._dry(theta, shape)
        motion = swing(now, rest.history, opened.state, opened.at_s, self.begin_s, last, dry, slopes)
        if motion is None:
            return bad
        start_by, log_by = np.zeros((8, size)), np.zeros((7, size))
        start_by[:, _START], start_by[:, _ZEROS] = opened.by_angle, -opened.by_angle
        start_by[:, list(OPENS)] = opened.start_by_instant(motion.start_rates)
        start_by[:, _DISK] = opened.by_deviation
        start_by[:, :2], start_by[:, SUSPENSION] = opened.by_logarithm[:, :2], opened.by_logarithm[:, 2:]
        log_by[0, 0] = log_by[1, 1] = 1.0
        log_by[2:, SUSPENSION] = np.eye(5)
        angle, slope = both_angles(motion, cut, start_by, log_by, dry_by)
        zero = np.repeat([0, 1], [len(c.time_s) for c in cut])
        slope[np.arange(count), 4 + zero] += 1.0
        return angle + theta[_ZEROS][zero], slope

    def _dry(self, theta: np.ndarray, shape: Shape | None) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Return M_A, M_B, F_A, F_B and their derivatives by θ."""
        if shape is None:
            return None, None
        w2 = self.speed_rad_s**2
        unit = np.diag([1.0, 1.0, 1.0 / w2, 1.0 / w2])
        unit = {"torque": unit[:, :2], "contact": unit[:, 2:], "both": unit}[shape]
        at = slice(_BASE, _BASE + _unknowns(shape))
        by = np.zeros((4, len(theta)))
        by[:, at] = unit
        return unit @ theta[at], by

    def with_torque(self, theta: np.ndarray, torque_Nm: np.ndarray) -> np.ndarray:
        """Return θ of a problem with friction from that of a problem without."""
        return np.r_[theta[:_BASE], torque_Nm, theta[_BASE:]]

    def friction_evidence(self, minimum: Minimum, end_s: float) -> Evidence:
        """Return the score test for friction in a fit without friction."""
        plain = self.problem()
        first, second = plain.cut(end_s)
        columns, rounding = self.torque_columns(minimum, end_s), plain.rounding(minimum, end_s, 40)
        return evidence(minimum, columns, rounding, (len(first.time_s), len(second.time_s)))

    def torque_columns(self, minimum: Minimum, end_s: float) -> np.ndarray:
        """Return derivatives of the weighted readings by friction of A and B per N m, for a fit without, (n, 2)."""
        problem = self.problem("torque")
        _, slope = problem.predict(self.with_torque(minimum.theta, np.zeros(2)), end_s)
        weight = np.concatenate([c.weight for c in problem.cut(end_s)])
        return slope[:, _BASE : _BASE + 2] * weight[:, None]

    def open_friction(
        self, shape: Shape | None, minimum: Minimum, end_s: float, setting: Setting
    ) -> OpenFriction | None:
        """Return damping and free friction from a fit with friction of one shape; None if the fit fails.

        If the readings do not determine both M and F, the result is M + F ω² by the shape of the fit.
        """
        problem, w2 = self.problem("both"), self.speed_rad_s**2
        wanted = [0, 1, *range(_BASE, _BASE + 4)]
        own, scale = slice(_BASE, _BASE + 4), np.array([1.0, 1.0, w2, w2])
        problem.prior_std[:2] = _DAMPING_STD
        problem.prior_std[own] = scale * np.repeat([TORQUE_STD_Nm, CONTACT_STD_kg_m2], 2)
        torque, after = np.zeros(4), _BASE + _unknowns(shape)
        if shape is not None:
            at = 2 if shape == "contact" else 0
            torque[at : at + 2] = minimum.theta[_BASE:after]
        found = problem.opened(np.r_[minimum.theta[:_BASE], torque, minimum.theta[after:]], end_s)
        if found is None:  # M and F that nearly cancel lie far away along a valley
            start = minimum.theta if shape else self.with_torque(minimum.theta, np.zeros(2))
            dry = self.problem(shape or "torque").opened(start, end_s)
            return None if dry is None else self._at_this_speed(shape or "torque", dry, end_s, setting)
        unit = np.r_[1.0, 1.0, 1.0 / scale]
        # M and F ω² have nearly the same effect. The dependence of c on each comes from the covariance of white noise,
        # since the scatter of a hundred rounding draws would distort it. The draws only give the common stretch.
        white = found.minimum.covariance[np.ix_(wanted, wanted)]
        seen = np.zeros((4, 6))
        seen[[0, 1, 2, 3, 2, 3], range(6)] = 1.0
        drawn = seen @ problem.covariance(found.minimum, end_s, setting, wanted) @ seen.T
        stretch = max(1.0, float(np.max(np.diag(drawn) / np.diag(seen @ white @ seen.T))))
        by = self.by_number(problem, found.minimum, end_s, "both", wanted)
        covariance = stretch * white * np.outer(unit, unit)
        return OpenFriction(found.values[wanted] * unit, covariance, {name: v * unit for name, v in by.items()})

    def _at_this_speed(self, shape: Shape, found: OpenedFit, end_s: float, setting: Setting) -> OpenFriction:
        wanted, w2 = [0, 1, _BASE, _BASE + 1], self.speed_rad_s**2
        problem = self.problem(shape)
        own = problem.covariance(found.minimum, end_s, setting, wanted)
        by = self.by_number(problem, found.minimum, end_s, shape, wanted)
        c, one, two = found.values[:2], found.values[_BASE : _BASE + 2], np.zeros(2)
        values = np.r_[c, two, one / w2] if shape == "contact" else np.r_[c, one, two]
        spread = {
            name: np.r_[v[:2], two, v[2:] / w2] if shape == "contact" else np.r_[v, two] for name, v in by.items()
        }
        return replace(OpenFriction.of_torque_at(values, own, w2), by_number=spread)

    def by_number(
        self, problem: TransientProblem, minimum: Minimum, end_s: float, shape: Shape | None, wanted: Sequence[int]
    ) -> dict[str, np.ndarray]:
        """Return derivatives of components of θ by masses, lengths, both encoders' zeros and the index angle.

        Args:
            problem: problem of this release with dry friction of the shape.
            minimum: minimum of the problem for data up to `end_s`.
            end_s: last instant of the data, s.
            shape: shape of the dry friction.
            wanted: m indices in θ.
        Returns:
            Number → derivative, shape (m,), per unit of the number.
        """

        def made(knowledge: Knowledge) -> TransientProblem:
            return self.laid_over(knowledge).problem(shape)

        found = by_physical_numbers(problem, minimum, end_s, self.knowledge, made, wanted)
        for name, at in zip((ZERO_A, ZERO_B), (4, 5), strict=True):
            found[name] = minimum.covariance[list(wanted), at] / self._zero_std**2
        if self.run.phase_absolute:
            there, theta = self.fixed(minimum.theta)
            free = len(self.speed.modes)
            own, phase = np.split(theta, [len(theta) - free])
            cut = problem.cut(end_s)
            turned, _ = there.angles(own, cut, np.r_[phase, _TURN_RAD], shape, False)
            n = len(turned)
            measured, weight = (np.concatenate([getattr(c, of) for c in cut]) for of in ("value", "weight"))
            change = np.zeros(len(minimum.residual))
            change[:n] = (turned - measured) * weight - minimum.residual[:n]
            found[INDEX] = answer_to(minimum, change / _TURN_RAD, wanted)
        return found

    def openings(self, minimum: Minimum) -> tuple[Opening, Opening]:
        """Return the instants at which the locks of A and B opened, by a fit."""
        late = minimum.theta[list(OPENS)] - self.message_s
        std = np.sqrt(np.diag(minimum.covariance)[list(OPENS)])
        each = zip("AB", late.tolist(), std.tolist(), self.expected_std_s.tolist(), strict=True)
        a, b = (Opening(*one) for one in each)
        return a, b

    def friction(self, minimum: Minimum, covariance: np.ndarray, shape: Shape) -> Friction:
        """Return the friction of a fit.

        Args:
            minimum: minimum with dry friction.
            covariance: covariance of both torques, shape (2, 2).
            shape: shape of the dry friction.
        """
        first, second = minimum.theta[_BASE : _BASE + 2].tolist()
        std = np.sqrt(np.diag(covariance))
        if shape == "torque":
            return Friction((first, second), (float(std[0]), float(std[1])), speed_rad_s=self.speed_rad_s)
        w2 = self.speed_rad_s**2
        none = (0.0, 0.0)
        return Friction(none, none, (first / w2, second / w2), (std[0] / w2, std[1] / w2), self.speed_rad_s)

    @property
    def opened(self) -> RecordedRelease:
        """The release with free masses and lengths of the pendulums, for those with a stated uncertainty.

        They remain fixed if the phase has no reference, because the search requires the unknown angle as the last of θ.
        """
        known: Mapping[str, float] = self.knowledge.number_std if self.run.phase_absolute else {}
        return replace(self, number_std={name: known[name] for name in PENDULUMS if known.get(name)})

    def fixed(self, theta: np.ndarray) -> tuple[RecordedRelease, np.ndarray]:
        """Return the release with the free numbers fixed at their values in θ, and the other components of θ."""
        if not self.number_std:
            return self, theta
        own, off = np.split(theta.copy(), [len(theta) - len(self.number_std)])
        moved = self.knowledge
        for (name, std), share in zip(self.number_std.items(), off.tolist(), strict=True):
            moved = moved.moved(name, share * std)
            own[SUSPENSION] += share * std * self.knowledge.by_number.get(name, np.zeros(5))
        return replace(self, knowledge=moved, number_std={}), own

    def horizons(self, setting: Setting) -> list[float]:
        """Return the last instants of the stretches: 0.5 s, growing by 1.6, up to the rest of both angles, s."""
        found = _horizons(self.readings)
        return found[: max(2, len(found) - 2)] if setting == "fast" else found

    def laid_over(self, physics_knowledge: Knowledge) -> RecordedRelease:
        """Return the same recording with other prior knowledge."""
        return replace(self, knowledge=physics_knowledge)


def _unknowns(shape: Shape | None) -> int:
    return 0 if shape is None else 4 if shape == "both" else 2


def _release_times(run: Run, opening_std_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the instants of the messages of A and B, and the standard uncertainty of the locks' opening after them."""
    found = {r.pendulum: r for r in run.releases}
    if set(found) != {0, 1}:
        raise NotIdentifiable(f"{run.source}: expected a release of both pendulums, found {len(found)} released")
    messages = np.array([found[i].time_s for i in range(2)])
    worst = max(r.time_std_s for r in found.values())
    if worst >= _MAX_TIME_STD_S:
        found, needed = distinct(worst, _MAX_TIME_STD_S)
        raise NotIdentifiable(
            f"{run.source}: the standard uncertainty of the instant of release is {found} s, as for a release by "
            f"hand; below {needed} s is needed for the damping. Record a spin-down"
        )
    std = np.hypot([found[i].time_std_s for i in range(2)], opening_std_s)
    apart = abs(float(messages[1] - messages[0]))
    if apart > 2e-3 + 3 * worst:
        raise NotIdentifiable(f"{run.source}: the pendulums were released {apart:.3g} s apart; release both at once")
    return messages, std


def _locked_start(run: Run, release_s: float) -> tuple[LockedStart, RecordedSpeed]:
    """Return the locked rig before the release and the rotor phase over the stretch that the fit needs."""
    try:
        speed = recorded_speed(run, release_s - _MEMORY_S - 1.0)
    except OutsideDomain as error:
        raise NotIdentifiable(f"{run.source}: {error}") from error
    history = speed.history
    earliest = max(float(history.knots_s[0]), release_s - _MEMORY_S)
    if earliest > release_s - 0.2:
        raise NotIdentifiable(f"{run.source}: the speed is not recorded for 0.2 s before the release; record longer")
    return LockedStart(history, earliest, release_s), speed


def _readings(run: Run, begin_s: float, block_s: float) -> tuple[EncoderReadings, EncoderReadings]:
    keep = run.angle_time_s > begin_s
    out: list[EncoderReadings] = []
    for i in range(2):
        good = keep & np.isfinite(run.angle_rad[:, i])
        time, angle = run.angle_time_s[good], run.angle_rad[good, i]
        if len(angle) < 500:
            raise NotIdentifiable(f"{run.source}: only {number_of(len(angle), 'encoder sample')} after the release")
        step = encoder_step(angle)  # the step in the recording may be wrong, or the angle is not quantised
        noise = encoder_noise(angle, step) if step else encoder_noise(angle, 1e-6)
        out.append(EncoderReadings(time, angle, block_averages(time, angle, block_s, noise), step))
    return out[0], out[1]


def fitted_until(angles: Sequence[tuple[Array, Array]]) -> float:
    """Return the last instant of a release that is fitted, shortly after both pendulums have come to rest, s.

    The rounding of a pendulum at rest is constant instead of noise.

    Args:
        angles: times, s, and angles, rad, of each pendulum from the release to the end of the record, shape (n,) each.
    """
    begin = last = float(angles[0][0][0])
    for time_s, angle in angles:
        tail = angle[time_s > time_s[-1] - 1.0]
        moving = np.abs(angle - tail.mean()) > 0.03 * np.ptp(angle) + 2 * np.ptp(tail)
        if np.ptp(tail) > 0.2 * np.ptp(angle):  # it still creeps or swings
            last = float(time_s[-1])
        elif moving.any():
            last = max(last, float(time_s[np.flatnonzero(moving)[-1]]))
    return min(last + _AFTER_SETTLING_S, begin + _LONGEST_S, *(float(time_s[-1]) for time_s, _ in angles))


def _horizons(readings: tuple[EncoderReadings, EncoderReadings]) -> list[float]:
    """Return the last instants of the stretches: 0.5 s, growing by 1.6, up to the rest of both angles, s."""
    blocks = [r.averages for r in readings]
    begin = blocks[0].time_s[0]
    end = fitted_until([(c.time_s, c.value) for c in blocks])
    return [float(begin + s) for s in 0.5 * 1.6 ** np.arange(10) if s < 0.7 * (end - begin)] + [float(end)]
