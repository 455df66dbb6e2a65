"""What the encoders read of a release, as least squares: unknowns, knowledge, readings and derivatives.

θ = (ln c3, ln c4, θ3, θ4 at release, two encoder zeros, shift of the release's time, the disk's deviation x, y, ẋ, ẏ
from its locked orbit, ln k1, ln k2, ln ζ1, ln ζ2, ln S_P), then with dry friction its torque on A and B at the rotor's
speed (of both shapes: first one's, then the other's), then what the recorded phase leaves open, then the errors of the
pendulums' masses and lengths where these are open.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from daq.signals.phase_noise import encoder_step
from daq.signals.run import Run
from dynamics.errors import OutsideDomain
from identification.errors import NotIdentifiable
from identification.least_squares import Minimum
from identification.pendulums.free_angles import both_angles, laid_over, log_suspension, swing
from identification.pendulums.friction import Evidence, Friction, evidence
from identification.pendulums.known_numbers import answer_to, by_physical_numbers
from identification.pendulums.locked_start import LockedStart
from identification.pendulums.open_friction import CONTACT_STD_kg_m2, OpenFriction, TORQUE_STD_Nm
from identification.pendulums.open_numbers import PENDULUMS, with_open_numbers
from identification.pendulums.recorded_speed import RecordedSpeed, recorded_speed
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import Readings, TransientProblem
from identification.pendulums.unknown_phase import TURN_STD_RAD, with_phase
from identification.samples import Averages, block_averages, encoder_noise
from identification.setting import Setting
from rig_configs.known import INDEX, ZERO_A, ZERO_B

Shape = Literal["torque", "contact", "both"]
"""How dry friction goes with the speed: a torque the same at any, one that goes with the contact force, or both."""

SUSPENSION, _BASE = slice(11, 16), 16
_START, _ZEROS, _SHIFT, _DISK = slice(2, 4), slice(4, 6), 6, slice(7, 11)
_VAGUE_S = 0.03  # a release whose instant is known no better would bias the damping
_BLOCK_S = {"fast": 0.004, "balanced": 0.004, "reference": 0.001}
_SHIFT_STD_S, _DISK_STD_M = 1e-3, 2e-5
_EXACT_RAD, _TURN_RAD = 1e-7, 1e-5  # zeros taken as exact; a step of the index angle
_LONGEST_S, _AFTER_SETTLING_S, _MEMORY_S = 25.0, 0.5, 12.0
_DAMPING_STD = 2.5  # ln c: a start a hundred times wrong is within two of it
_DAMPING_BESIDE_STD = 0.7  # beside dry friction, which could otherwise stand in for all of it


@dataclass(frozen=True)
class Release:
    """One recorded release.

    Attributes:
        run: the recording.
        knowledge: masses, lengths, suspension, and damping to start from.
        rest: the locked rig up to it.
        speed: the rotor's phase, and how far it may be otherwise.
        begin_s: from where on readings are fitted.
        release_std_s: how well its instant is known.
        readings: both encoders from begin_s on.
        locked_rad: their mean readings before, shape (2,).
        zero_std_rad: of the encoders' zeros.
        number_std: known number that is open → its standard uncertainty.
    """

    run: Run
    knowledge: Knowledge
    rest: LockedStart
    speed: RecordedSpeed
    begin_s: float
    release_std_s: float
    readings: tuple[Readings, Readings]
    locked_rad: np.ndarray
    zero_std_rad: float
    number_std: Mapping[str, float] = field(default_factory=dict[str, float])

    @classmethod
    def of(cls, run: Run, knowledge: Knowledge, zero_std_rad: float, setting: Setting) -> Release:
        """What a run holds of a release.

        Raises:
            NotIdentifiable: no releases, or too few marks or samples.
        """
        go, go_std = _release_time(run)
        rest, speed = _locked_start(run, go)
        begin = go + max(_BLOCK_S["balanced"], 4 * go_std)
        readings = _readings(run, begin, _BLOCK_S[setting])
        before = (run.angle_time_s < go - 0.02) & (run.angle_time_s > go - 2.0)
        if np.count_nonzero(before) < 100:
            raise NotIdentifiable(f"{run.source}: no encoder samples of the locked pendulums before the release")
        locked = np.nanmean(run.angle_rad[before], axis=0)
        return cls(run, knowledge, rest, speed, begin, go_std, readings, locked, zero_std_rad)

    @property
    def speed_rad_s(self) -> float:
        """The rotor's speed at the release."""
        return float(self.rest.history.phase(self.rest.release_s)[0, 1])

    @property
    def moved_rad(self) -> np.ndarray:
        """How far each pendulum goes after the release, without the encoders' flicker, shape (2,)."""
        ranges = [np.quantile(r.averages.value, [0.005, 0.995]) for r in self.readings]
        return np.array([float(high - low) for low, high in ranges])

    @property
    def start(self) -> np.ndarray:
        """θ to begin with, without friction and phase, shape (16,)."""
        physics = self.knowledge.physics
        damping = np.log([physics.a.damping_Nms_per_rad, physics.b.damping_Nms_per_rad])
        return np.r_[damping, self.locked_rad, np.zeros(7), log_suspension(physics)]

    @property
    def _zero_std(self) -> float:
        """Of the encoders' zeros; of exact ones, so little that it hardly counts."""
        return max(self.zero_std_rad, _EXACT_RAD)

    @property
    def open_phase(self) -> int:
        """How many unknowns the phase brings, the last of θ."""
        return len(self.speed.modes) + int(not self.run.phase_absolute)

    def problem(self, shape: Shape | None = None) -> TransientProblem:
        """The least-squares problem, with dry friction of a shape or without."""
        start, omega = self.start, self.knowledge.physics.natural_frequencies_rad_s[0]
        # start angles are the locked ones less the zeros; the mean of quantised readings at rest is good to a step/√12
        angle_std = max(max(r.step_rad for r in self.readings) / np.sqrt(12), 1e-5)
        damping_std = _DAMPING_STD if shape is None else _DAMPING_BESIDE_STD
        std = np.r_[
            damping_std,
            damping_std,
            angle_std,
            angle_std,
            self._zero_std,
            self._zero_std,
            self.release_std_s,
            _DISK_STD_M,
            _DISK_STD_M,
            _DISK_STD_M * omega,
            _DISK_STD_M * omega,
            self.knowledge.log_std,
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
        """Readings of both encoders and derivatives: θ's start angles are readings, the true ones less by the zeros."""
        count, size = sum(len(c.time_s) for c in cut), len(theta)
        bad = np.full(count, np.nan), np.zeros((count, size))
        if not np.all(np.isfinite(theta)) or np.max(np.abs(theta[[0, 1, *range(11, 16)]])) > 40:
            return bad
        rest = self.rest.along(self.speed.moved(phase)) if np.any(phase) else self.rest
        try:
            now = laid_over(self.knowledge, theta[:2], theta[SUSPENSION])
        except OutsideDomain:  # a trial that no rig can be
            return bad
        true, at = theta[_START] - theta[_ZEROS], theta[_SHIFT]
        state, by = rest.at(now, true[0], true[1], at)
        state[[0, 1, 4, 5]] += theta[_DISK]
        last = max(float(c.time_s[-1]) for c in cut)
        dry, dry_by = self._dry(theta, shape)
        motion = swing(now, rest.history, state, rest.release_s + at, self.begin_s, last, dry, slopes)
        if motion is None:
            return bad
        start_by, log_by = np.zeros((8, size)), np.zeros((7, size))
        start_by[:, _START], start_by[:, _ZEROS] = by[:, :2], -by[:, :2]
        start_by[:, _SHIFT] = by[:, 2] - motion.start_rates  # a later start has moved less
        start_by[[0, 1, 4, 5], [7, 8, 9, 10]] = 1.0
        start_by[:, SUSPENSION] = by[:, 3:]
        log_by[0, 0] = log_by[1, 1] = 1.0
        log_by[2:, SUSPENSION] = np.eye(5)
        angle, slope = both_angles(motion, cut, start_by, log_by, dry_by)
        zero = np.repeat([0, 1], [len(c.time_s) for c in cut])
        slope[np.arange(count), 4 + zero] += 1.0
        return angle + theta[_ZEROS][zero], slope

    def _dry(self, theta: np.ndarray, shape: Shape | None) -> tuple[np.ndarray | None, np.ndarray | None]:
        """M_A, M_B, F_A, F_B and their derivatives by θ."""
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
        """θ of a problem without friction as one with it."""
        return np.r_[theta[:_BASE], torque_Nm, theta[_BASE:]]

    def friction_evidence(self, minimum: Minimum, end_s: float) -> Evidence:
        """Whether friction would mend a fit that goes without."""
        plain = self.problem()
        first, second = plain.cut(end_s)
        columns, rounding = self.torque_columns(minimum, end_s), plain.rounding(minimum, end_s, 40)
        return evidence(minimum, columns, rounding, (len(first.time_s), len(second.time_s)))

    def torque_columns(self, minimum: Minimum, end_s: float) -> np.ndarray:
        """Derivatives of the weighted readings by friction of A and B for a fit without, shape (n, 2), per N m."""
        problem = self.problem("torque")
        _, slope = problem.predict(self.with_torque(minimum.theta, np.zeros(2)), end_s)
        weight = np.concatenate([c.weight for c in problem.cut(end_s)])
        return slope[:, _BASE : _BASE + 2] * weight[:, None]

    def open_friction(
        self, shape: Shape | None, minimum: Minimum, end_s: float, setting: Setting
    ) -> OpenFriction | None:
        """What a fit with friction of one shape says of damping and all friction; None where it cannot be followed.

        Where that is too much for the readings, M + F ω² counts as what the fit's own shape made of it.
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
        if found is None and shape is None:  # M and F that nearly cancel are far off along their valley
            start = self.with_torque(minimum.theta, np.zeros(2))
            dry = self.problem("torque").opened(start, end_s)
            return None if dry is None else self._at_this_speed("torque", dry, end_s, setting)
        if found is None:
            return self._at_this_speed(shape or "torque", minimum, end_s, setting)
        unit = np.r_[1.0, 1.0, 1.0 / scale]
        # M and F ω² are seen as nearly one: how c goes with each is known from the white noise's covariance, while a
        # hundred draws of the rounding would blur it; they tell by how much all of it is longer
        white = found.covariance[np.ix_(wanted, wanted)]
        seen = np.zeros((4, 6))
        seen[[0, 1, 2, 3, 2, 3], range(6)] = 1.0
        drawn = seen @ problem.covariance(found, end_s, setting, wanted) @ seen.T
        stretch = max(1.0, float(np.max(np.diag(drawn) / np.diag(seen @ white @ seen.T))))
        by = self.by_number(problem, found, end_s, "both", wanted)
        covariance = stretch * white * np.outer(unit, unit)
        return OpenFriction(found.theta[wanted] * unit, covariance, {name: v * unit for name, v in by.items()})

    def _at_this_speed(self, shape: Shape, minimum: Minimum, end_s: float, setting: Setting) -> OpenFriction:
        wanted, w2 = [0, 1, _BASE, _BASE + 1], self.speed_rad_s**2
        problem = self.problem(shape)
        own = problem.covariance(minimum, end_s, setting, wanted)
        by = self.by_number(problem, minimum, end_s, shape, wanted)
        one, two = minimum.theta[_BASE : _BASE + 2], np.zeros(2)
        values = np.r_[minimum.theta[:2], two, one / w2] if shape == "contact" else np.r_[minimum.theta[:2], one, two]
        spread = {
            name: np.r_[v[:2], two, v[2:] / w2] if shape == "contact" else np.r_[v, two] for name, v in by.items()
        }
        return replace(OpenFriction.of_torque_at(values, own, w2), by_number=spread)

    def by_number(
        self, problem: TransientProblem, minimum: Minimum, end_s: float, shape: Shape | None, wanted: Sequence[int]
    ) -> dict[str, np.ndarray]:
        """How some of θ go with the known numbers: masses, lengths, both encoders' zeros and the index angle.

        Args:
            problem: of this release, with dry friction of the shape.
            minimum: its, at the last instant.
            wanted: places in θ, m of them.
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

    def friction(self, minimum: Minimum, covariance: np.ndarray, shape: Shape) -> Friction:
        """The friction that a fit found; covariance of both torques, shape (2, 2)."""
        first, second = minimum.theta[_BASE : _BASE + 2].tolist()
        std = np.sqrt(np.diag(covariance))
        if shape == "torque":
            return Friction((first, second), (float(std[0]), float(std[1])), speed_rad_s=self.speed_rad_s)
        w2 = self.speed_rad_s**2
        none = (0.0, 0.0)
        return Friction(none, none, (first / w2, second / w2), (std[0] / w2, std[1] / w2), self.speed_rad_s)

    @property
    def opened(self) -> Release:
        """The same with the pendulums' masses and lengths open as far as their uncertainties are stated.

        Where the phase has no reference they stay: an unknown angle is searched for as the last of θ.
        """
        known = self.knowledge.number_std if self.run.phase_absolute else {}
        return replace(self, number_std={name: known[name] for name in PENDULUMS if known.get(name)})

    def fixed(self, theta: np.ndarray) -> tuple[Release, np.ndarray]:
        """The release with the numbers that θ has found in place of open ones, and the rest of θ."""
        if not self.number_std:
            return self, theta
        own, off = np.split(theta.copy(), [len(theta) - len(self.number_std)])
        moved = self.knowledge
        for (name, std), share in zip(self.number_std.items(), off.tolist(), strict=True):
            moved = moved.moved(name, share * std)
            own[SUSPENSION] += share * std * self.knowledge.by_number.get(name, np.zeros(5))
        return replace(self, knowledge=moved, number_std={}), own

    def horizons(self, setting: Setting) -> list[float]:
        """Last instants: 0.5 s on, then 1.6 times as long each time, up to where both angles have come to rest."""
        found = _horizons(self.readings)
        return found[: max(2, len(found) - 2)] if setting == "fast" else found

    def laid_over(self, physics_knowledge: Knowledge) -> Release:
        """The same recording with other masses and lengths."""
        return replace(self, knowledge=physics_knowledge)


def _unknowns(shape: Shape | None) -> int:
    return 0 if shape is None else 4 if shape == "both" else 2


def _release_time(run: Run) -> tuple[float, float]:
    times = {r.pendulum: r.time_s for r in run.releases}
    if set(times) != {0, 1}:
        raise NotIdentifiable(f"{run.source}: it holds no release of both pendulums")
    if abs(times[0] - times[1]) > 2e-3 + 3 * max(r.time_std_s for r in run.releases):
        raise NotIdentifiable(f"{run.source}: pendulums released {abs(times[0] - times[1]):.3g} s apart")
    worst = max(r.time_std_s for r in run.releases)
    if worst >= _VAGUE_S:
        raise NotIdentifiable(
            f"{run.source}: the instant of release is known to ± {worst:.2g} s only, as of one by hand: too "
            f"little for their damping, wanted below {_VAGUE_S:g} s. Record a spin-down"
        )
    return 0.5 * (times[0] + times[1]), max(_SHIFT_STD_S, *(r.time_std_s for r in run.releases))


def _locked_start(run: Run, release_s: float) -> tuple[LockedStart, RecordedSpeed]:
    """The speed over what the fit needs."""
    try:
        speed = recorded_speed(run, release_s - _MEMORY_S - 1.0)
    except OutsideDomain as error:
        raise NotIdentifiable(f"{run.source}: {error}") from error
    history = speed.history
    earliest = max(float(history.knots_s[0]), release_s - _MEMORY_S)
    if earliest > release_s - 0.2:
        raise NotIdentifiable(f"{run.source}: the speed before the release is not known")
    return LockedStart(history, earliest, release_s), speed


def _readings(run: Run, begin_s: float, block_s: float) -> tuple[Readings, Readings]:
    keep = run.angle_time_s > begin_s
    out = []
    for i in range(2):
        good = keep & np.isfinite(run.angle_rad[:, i])
        time, angle = run.angle_time_s[good], run.angle_rad[good, i]
        if len(angle) < 500:
            raise NotIdentifiable(f"{run.source}: {len(angle)} encoder samples after the release are too few")
        step = encoder_step(angle)  # what the recording says of it may be wrong, or it is not quantised
        noise = encoder_noise(angle, step) if step else encoder_noise(angle, 1e-6)
        out.append(Readings(time, angle, block_averages(time, angle, block_s, noise), step))
    return out[0], out[1]


def _horizons(readings: tuple[Readings, Readings]) -> list[float]:
    """Last instants: 0.5 s on, then 1.6 times as long each time, up to where both angles have come to rest."""
    blocks = [r.averages for r in readings]
    begin = last = blocks[0].time_s[0]
    for channel in blocks:
        tail = channel.value[channel.time_s > channel.time_s[-1] - 1.0]
        moving = np.abs(channel.value - tail.mean()) > 0.03 * np.ptp(channel.value) + 2 * np.ptp(tail)
        if np.ptp(tail) > 0.2 * np.ptp(channel.value):  # it creeps, or swings on
            last = channel.time_s[-1]
        elif moving.any():
            last = max(last, channel.time_s[np.flatnonzero(moving)[-1]])
    end = min(last + _AFTER_SETTLING_S, begin + _LONGEST_S, *(float(c.time_s[-1]) for c in blocks))
    return [float(begin + s) for s in 0.5 * 1.6 ** np.arange(10) if s < 0.7 * (end - begin)] + [float(end)]
