"""Least-squares problem of a spin-down on a resting rotor: unknowns, encoder readings and derivatives.

θ is as in identification.pendulums.spin_down_run, followed by the values of each kind of friction for A and B.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dynamics.equations.speed_history import SpeedHistory
from dynamics.errors import OutsideDomain
from identification.errors import NotIdentifiable
from identification.least_squares import Minimum
from identification.pendulums.free_angles import both_angles, laid_over, log_suspension, swing
from identification.pendulums.friction import Evidence, evidence
from identification.pendulums.known_numbers import by_physical_numbers
from identification.pendulums.off_axis import UNKNOWNS, columns, with_off_axis
from identification.pendulums.open_friction import CONTACT_STD_kg_m2, OpenFriction, TORQUE_STD_Nm
from identification.pendulums.push import TIME_CONSTANTS, Decline
from identification.pendulums.suspension_knowledge import Knowledge
from identification.pendulums.transient import EncoderReadings, TransientProblem
from identification.samples import Averages
from identification.setting import Setting

Kind = Literal["torque", "contact"]
Kinds = tuple[Kind, ...]
"""Kinds of friction: a torque independent of the speed, and a torque with its square (by the contact force)."""
BOTH: Kinds = ("torque", "contact")

PSI, COUNT = 6, 15
_ANGLES, _SPEEDS, _DISK, _SUSPENSION = slice(2, 4), slice(4, 6), slice(7, 11), slice(11, 15)
_DAMPING_STD = 1.0  # prior of ln c, for a pendulum that does not move yet
_DISK_STD_M = 3e-4  # standard deviation of the disk's displacement after a flick
_AFTER_STOP_S = 0.05
_MAX_NEGATIVE_STD = 2.0  # standard deviations below 0 up to which a friction value is accepted


@dataclass(frozen=True)
class SpinDown:
    """One stretch of a spin-down.

    Attributes:
        whole: readings of both encoders over the whole record.
        declines: push and run-down of each pendulum.
        begin_s, end_s: begin and end of the stretch, s.
        knowledge: masses, lengths and prior knowledge of the suspension.
        off_axis: whether the encoders may be mounted off their axes; their errors are then the last unknowns of θ.
    """

    whole: list[EncoderReadings]
    declines: list[Decline]
    begin_s: float
    end_s: float
    knowledge: Knowledge
    off_axis: bool = False

    @property
    def readings(self) -> tuple[EncoderReadings, EncoderReadings]:
        """Readings of the stretch; each encoder's end after TIME_CONSTANTS of its pendulum or at the stop by friction.

        Raises:
            NotIdentifiable: there are fewer than 12 blocks.
        """
        ends = [
            min(self.end_s, max(self.begin_s, d.start_s) + TIME_CONSTANTS / d.rate_per_s, d.stop_s + _AFTER_STOP_S)
            for d in self.declines
        ]
        first, second = (w.between(self.begin_s, e) for w, e in zip(self.whole, ends, strict=True))
        if min(len(first.averages.time_s), len(second.averages.time_s)) < 12:
            raise NotIdentifiable(
                "fewer than 12 blocks of readings between two flicks; flick both at once or a second apart"
            )
        return first, second

    def problem(self, kinds: Kinds) -> TransientProblem:
        """Return the least-squares problem with the given kinds of friction."""
        size = COUNT + 2 * len(kinds)
        prior_std = np.full(size, np.inf)
        omega = np.array(self.knowledge.physics.natural_frequencies_rad_s)
        prior_std[:2], prior_std[PSI] = _DAMPING_STD, np.pi
        prior_std[_DISK] = np.r_[_DISK_STD_M, _DISK_STD_M, _DISK_STD_M * omega]
        prior_std[_SUSPENSION] = self.knowledge.log_std[:4]
        prior = self.start(kinds, 0.0)[:size]

        def predict(theta: np.ndarray, end_s: float, slopes: bool = True, /) -> tuple[np.ndarray, np.ndarray]:
            return self._angles(theta, problem.cut(end_s), kinds, slopes)

        problem = TransientProblem(self.readings, predict, prior, prior_std)
        return with_off_axis(problem) if self.off_axis else problem

    def start(self, kinds: Kinds, psi: float) -> np.ndarray:
        """Return a start value of θ from exponentials, with the rotor at ψ and the friction of the run-downs."""
        physics, start = self.knowledge.physics, np.zeros(COUNT + 2 * len(kinds))
        inertias = (physics.a.inertia_kg_m2, physics.b.inertia_kg_m2)
        for i, (reading, decline) in enumerate(zip(self.readings, self.declines, strict=True)):
            channel, rate = reading.averages, decline.rate_per_s
            t = channel.time_s - self.begin_s
            basis = np.column_stack([np.ones_like(t), np.exp(-rate * t)])
            rest, amplitude = np.linalg.lstsq(basis, channel.value, rcond=None)[0]
            if self.begin_s < decline.push_s:  # not yet flicked
                rest, amplitude = float(np.mean(channel.value)), 0.0
            start[i] = np.log(rate * inertias[i])
            start[2 + i], start[4 + i] = rest + amplitude, -rate * amplitude
            if "torque" in kinds:
                at = COUNT + 2 * kinds.index("torque") + i
                start[at] = max(0.0, decline.friction_share) * rate * inertias[i] * decline.speed_rad_s
        start[PSI] = psi
        start[_SUSPENSION] = log_suspension(physics)[:4]
        return np.r_[start, np.zeros(self._errors)]

    @property
    def _errors(self) -> int:
        """Number of unknowns for the errors of the encoders."""
        return UNKNOWNS if self.off_axis else 0

    def with_off_axis(self, theta: np.ndarray) -> tuple[SpinDown, np.ndarray]:
        """Return the stretch with encoders that may be off their axes, and θ extended by errors of 0."""
        return replace(self, off_axis=True), np.r_[theta, np.zeros(UNKNOWNS)]

    def off_axis_score(self, kinds: Kinds, minimum: Minimum) -> Evidence:
        """Return the score test for encoders that are mounted off their axes."""
        plain = self.problem(kinds)
        cut = plain.cut(self.end_s)
        sizes = (len(cut[0].time_s), len(cut[1].time_s))
        weight = np.concatenate([c.weight for c in cut])
        by = columns(plain.angles(minimum.theta, self.end_s), sizes) * weight[:, None]
        return evidence(minimum, by, plain.rounding(minimum, self.end_s, 40), sizes)

    def extended(self, theta: np.ndarray, kinds: Kinds, more: Kinds, values: Mapping[Kind, np.ndarray]) -> np.ndarray:
        """Return θ of a problem with more kinds of friction, whose values are the given ones, at least 0."""
        out = np.r_[theta[:COUNT], np.zeros(2 * len(more)), theta[len(theta) - self._errors :]]
        for i, kind in enumerate(more):
            at = COUNT + 2 * i
            if kind in kinds:
                old = COUNT + 2 * kinds.index(kind)
                out[at : at + 2] = theta[old : old + 2]
            else:
                out[at : at + 2] = np.maximum(values[kind], 0.0)
        return out

    def score(self, kinds: Kinds, kind: Kind, minimum: Minimum) -> Evidence:
        """Return the score test for another kind of friction."""
        more: Kinds = (*kinds, kind)
        plain, problem = self.problem(kinds), self.problem(more)
        theta = self.extended(minimum.theta, kinds, more, {kind: np.zeros(2)})
        _, slope = problem.predict(theta, self.end_s)
        cut = problem.cut(self.end_s)
        weight = np.concatenate([c.weight for c in cut])
        at = COUNT + 2 * len(kinds)
        sizes = (len(cut[0].time_s), len(cut[1].time_s))
        return evidence(
            minimum, slope[:, at : at + 2] * weight[:, None], plain.rounding(minimum, self.end_s, 40), sizes
        )

    def open_friction(self, kinds: Kinds, minimum: Minimum, setting: Setting) -> OpenFriction | None:
        """Return damping and free friction from a fit with some kinds of friction; None if the fit fails.

        The problem contains the kinds of BOTH; other kinds of the fit are left out.
        """
        problem = self.problem(BOTH)
        for kind, std in (("torque", TORQUE_STD_Nm), ("contact", CONTACT_STD_kg_m2)):
            at = COUNT + 2 * BOTH.index(kind)
            problem.prior[at : at + 2], problem.prior_std[at : at + 2] = 0.0, std
        problem.prior[PSI] = minimum.theta[PSI]  # as in the fit
        none: dict[Kind, np.ndarray] = {kind: np.zeros(2) for kind in BOTH}
        start = self.extended(minimum.theta, kinds, BOTH, none)
        found = problem.opened(start, self.end_s)
        if found is None:
            return None
        wanted = [0, 1, *range(COUNT, COUNT + 4)]
        by = self.by_number(problem, found.minimum, BOTH, wanted)
        covariance = problem.covariance(found.minimum, self.end_s, setting, wanted)
        return OpenFriction(found.values[wanted], covariance, by)

    def by_number(
        self, problem: TransientProblem, minimum: Minimum, kinds: Kinds, wanted: Sequence[int]
    ) -> dict[str, np.ndarray]:
        """Return derivatives of components of θ by masses and lengths.

        Args:
            problem: problem of this stretch with the kinds of friction.
            minimum: minimum of the problem.
            kinds: kinds of friction.
            wanted: m indices in θ.
        Returns:
            Number → derivative, shape (m,), per unit of the number.
        """

        def made(knowledge: Knowledge) -> TransientProblem:
            return replace(self, knowledge=knowledge).problem(kinds)

        return by_physical_numbers(problem, minimum, self.end_s, self.knowledge, made, wanted)

    def positive(self, minimum: Minimum, kinds: Kinds) -> bool:
        """Return whether no friction value is significantly negative, which would be unphysical."""
        std = np.sqrt(np.diag(minimum.covariance))
        at = slice(COUNT, COUNT + 2 * len(kinds))
        return bool(np.all(minimum.theta[at] > -_MAX_NEGATIVE_STD * std[at]))

    def _angles(
        self, theta: np.ndarray, cut: tuple[Averages, Averages], kinds: Kinds, slopes: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return angles of both encoders and derivatives for a rotor at rest at ψ."""
        count, size = sum(len(c.time_s) for c in cut), len(theta)
        bad = np.full(count, np.nan), np.zeros((count, size))
        if np.max(np.abs(theta[:2])) > 40 or np.max(np.abs(theta[_SUSPENSION])) > 40:
            return bad
        try:
            now = laid_over(self.knowledge, theta[:2], theta[_SUSPENSION])
        except OutsideDomain:  # usual: a trial with impossible parameters
            return bad
        state = np.r_[theta[7:9], theta[_ANGLES], theta[9:11], theta[_SPEEDS]]
        still = SpeedHistory.constant(0.0, float(theta[PSI]), self.begin_s)
        dry, dry_by = self._dry(theta, kinds)
        motion = swing(
            now, still, state, self.begin_s, self.begin_s, max(float(c.time_s[-1]) for c in cut), dry, slopes
        )
        if motion is None:
            return bad
        start_by, log_by = np.zeros((8, size)), np.zeros((7, size))
        start_by[[0, 1, 2, 3, 4, 5, 6, 7], [7, 8, 2, 3, 9, 10, 4, 5]] = 1.0
        start_by[[2, 3], PSI] = 1.0  # a rotation of the rotor rotates both pendulums and the zeros of the encoders
        log_by[0, 0] = log_by[1, 1] = 1.0
        log_by[2:6, _SUSPENSION] = np.eye(4)
        angle, slope = both_angles(motion, cut, start_by, log_by, dry_by)
        slope[:, PSI] -= 1.0
        return angle, slope

    @staticmethod
    def _dry(theta: np.ndarray, kinds: Kinds) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Return M_A, M_B, F_A, F_B and their derivatives by θ."""
        if not kinds:
            return None, None
        by = np.zeros((4, len(theta)))
        for i, kind in enumerate(kinds):
            row = 0 if kind == "torque" else 2
            by[row, COUNT + 2 * i] = by[row + 1, COUNT + 2 * i + 1] = 1.0
        return by @ theta, by
