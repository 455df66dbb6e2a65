"""Equations of small motions about a steady motion: δẏ = A(ψ) δy with A periodic in the rotor's phase.

State y = (x, y, θ3, θ4, ẋ, ẏ, θ̇3, θ̇4) with the disk centre in the space-fixed frame. In this frame the suspension is
constant, and only the pendulums' small contribution rotates with the rotor. Derivations: docs/theory/stability.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynamics.arrays import Array, Complex
from dynamics.compiled_code import compiled
from dynamics.equations.kernels import C1, CA, FA, FB, JA, K1, MASS, SA, jacobian
from dynamics.equations.parameters import RotorParameters
from dynamics.equations.periodic_matrix import PeriodicMatrix, turning
from dynamics.equations.quick_derivatives import rate_derivatives
from dynamics.errors import NotConverged, OutsideDomain

_TURN = np.array([-1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0])
_ROUNDING = np.finfo(float).eps
_MAX_PHASES = 4096


def kept_states(parameters: RotorParameters, released: tuple[bool, bool] = (True, True)) -> NDArray[np.intp]:
    """Indices of the moving states: angle and rate of a locked or absent pendulum are omitted."""
    free = [bool(r and p.present) for r, p in zip(released, (parameters.a, parameters.b), strict=True)]
    return np.flatnonzero(np.array([True, True, *free] * 2))


@compiled
def _resting_harmonics(p: Array, theta3: float, theta4: float, w: float, h: Complex) -> None:
    """Write harmonics 0, 1 and 2 of A(ψ) about the balanced state to h, shape (3, 8, 8), which must contain zeros.

    Args:
        p: packed parameters.
        theta3, theta4: balanced angles, rad; w: speed, rad/s.
    """
    arm = (complex(np.cos(theta3), np.sin(theta3)), complex(np.cos(theta4), np.sin(theta4)))
    m, g = p[MASS], 0j
    for i in range(2):
        mu = p[SA + i] * p[SA + i] / p[JA + i]
        m -= 0.5 * mu
        g -= 0.5 * mu * arm[i] * arm[i]
    det = (m - abs(g)) * (m + abs(g))
    for i in range(4):
        h[0, i, 4 + i] = 1.0
    for axis in range(2):
        unit, sign = (1.0 + 0j, 1.0) if axis == 0 else (-1j, -1.0)
        for column, force in ((axis, -p[K1 + axis]), (4 + axis, -p[C1 + axis])):
            h[0, 4 + axis, column] = m * force / det
            h[2, 4 + axis, column] = sign * g * force / det
            h[2, 5 - axis, column] = -1j * g * force / det
            for i in range(2):
                n = -1j * arm[i]
                softened = (m * n + g * np.conj(n)) / det
                h[1, 6 + i, column] = p[SA + i] / p[JA + i] * force * unit * softened
    for i in range(2):
        s, rate, normal = p[SA + i], p[CA + i] / p[JA + i], -1j * arm[i]
        for column, force in ((2 + i, -w * w * s * normal), (6 + i, s * (2 * w * arm[i] - rate * normal))):
            moved = (m * force + g * np.conj(force)) / det
            h[1, 4, column], h[1, 5, column] = moved, -1j * moved
            for r in range(2):
                h[0, 6 + r, column] = p[SA + r] / p[JA + r] * (1j * np.conj(arm[r]) * moved).real
        h[0, 6 + i, 6 + i] -= rate


def type_one(parameters: RotorParameters, theta3: float, theta4: float, speed_rad_s: float) -> PeriodicMatrix:
    """Small motions about the balanced state (Type I), exact: A(ψ) contains only the harmonics 0, 1 and 2.

    With a plane vector as a complex number, e_i = e^{i(ψ+θ_i)}, n_i = −i e_i and μ_i = S_i²/J_i the mass matrix is
    M b = m b − g e^{2iψ} b̄ with m = M_S − (μ_A + μ_B)/2, g = −½ Σ μ_i e^{2iθ_i}, and its inverse is
    (m a + g e^{2iψ} ā)/(m² − |g|²). It maps vectors that rotate with the rotor to vectors that rotate with it. Dry
    friction is neglected.

    Args:
        theta3, theta4: balanced angles (dynamics.equations.balancing.balanced_angles), rad.
        speed_rad_s: running speed ω, rad/s.
    Raises:
        OutsideDomain: gravity in the disk plane, a pivot shift or a bow. The rotor is then not at rest (use `along`).
    """
    p = parameters
    if p.gravity_m_per_s2 != 0 or p.pivot_shift_m != 0 or p.bow_m != 0:
        raise OutsideDomain(
            "the closed form of Type I needs gravity_m_per_s2 = 0, pivot_shift_m = 0 and no bow, got "
            f"{p.gravity_m_per_s2!r}, {p.pivot_shift_m!r} and {p.bow_m!r}; linearise along the computed orbit instead"
        )
    h = np.zeros((3, 8, 8), np.complex128)
    _resting_harmonics(p.packed(), theta3, theta4, speed_rad_s, h)
    if p.a.present and p.b.present:
        return PeriodicMatrix(h, speed_rad_s, _TURN)
    kept = kept_states(p)
    return PeriodicMatrix(np.ascontiguousarray(h[:, kept][:, :, kept]), speed_rad_s, _TURN[kept])


@compiled
def _matrices_along(states: Array, speed: float, p: Array, free_a: float, free_b: float, matrices: Array) -> None:
    """Write ∂(dy/dt)/∂y at equally spaced phases of a revolution, shape (n, 8, 8), for states of shape (n, 8)."""
    for i in range(len(states)):
        matrix = matrices[i]
        for row in range(4):
            for column in range(8):
                matrix[row, column] = 0.0
        matrix[0, 4] = matrix[1, 5] = 1.0
        matrix[2, 6], matrix[3, 7] = free_a, free_b
        rate_derivatives(states[i], 2 * np.pi * i / len(states), speed, p, free_a, free_b, matrix[4:])


def along(
    parameters: RotorParameters,
    states: Array,
    speed_rad_s: float,
    released: tuple[bool, bool] = (True, True),
    most_harmonics: int | None = None,
) -> PeriodicMatrix:
    """Small motions about a periodic motion, from exact derivatives at phases of a whole revolution.

    The states' trigonometric interpolant is sampled more densely until the matrix's own Fourier series has decayed, so
    that products of many harmonics do not alias. Dry friction is neglected. Damping that increases with the speed has a
    kink at zero speed: its series decreases as 1/k² and is truncated at `most_harmonics`.

    Args:
        states: shape (N, 8), at ψ_j = 2πj/N, N even; space-fixed x, y.
        speed_rad_s: running speed ω, rad/s.
        released: which pendulums are free.
        most_harmonics: order at which a series that has not decayed is truncated; the caller compares two orders.
            None: the series must decay.
    Raises:
        OutsideDomain: states of another shape.
        NotConverged: the Fourier series does not decay (the motion is too rough for the given phases).
    """
    if states.ndim != 2 or states.shape[1] != 8 or len(states) < 2 or len(states) % 2:
        raise OutsideDomain(f"states must have the shape (N, 8) with N even, got {states.shape}")
    packed = parameters.packed()
    packed[FA] = packed[FB] = 0.0
    kept = kept_states(parameters, released)
    turn = _TURN[kept] if parameters.gravity_m_per_s2 == 0 and _repeats_after_half(states) else None
    phases = max(16, len(states))
    while phases <= _MAX_PHASES:
        sampled = _resampled(states, phases)
        matrices = np.empty((phases, 8, 8))
        _matrices_along(sampled, speed_rad_s, packed, float(2 in kept), float(3 in kept), matrices)
        if len(kept) < 8:
            matrices = matrices[:, kept][:, :, kept]
        spectrum = np.fft.rfft(matrices, axis=0) / phases
        spectrum[1:] *= 2.0
        if turn is not None:  # entries that keep their sign over half a revolution have even orders, others odd orders
            odd = np.outer(turn, turn) < 0
            spectrum[0::2, odd] = 0.0
            spectrum[1::2, ~odd] = 0.0
        last = _highest_order(spectrum, np.max(np.abs(matrices), axis=0))
        if most_harmonics is not None and phases >= 8 * most_harmonics:
            last = min(last, most_harmonics)
        if last < 3 * phases // 8:
            return PeriodicMatrix(np.ascontiguousarray(spectrum[: last + 1]), speed_rad_s, turn)
        phases *= 2
    raise NotConverged(
        f"the matrix along the motion still has harmonics above rounding at order {_MAX_PHASES // 2}, expected none; "
        "give the motion at more phases"
    )


def _highest_order(spectrum: Complex, size: Array) -> int:
    """The highest order above the rounding of the states and of the matrix.

    Args:
        spectrum: shape (m + 1, n, n).
        size: largest value of each entry, shape (n, n).

    The rounding of the states is spread evenly over the orders, so the upper quarter of the spectrum measures it. An
    amplitude above 1e-11 of its row's largest entry is not rounding and counts.
    """
    row = np.max(size, axis=1, keepdims=True)
    amplitude = np.abs(spectrum)
    flat = np.max(amplitude[3 * len(spectrum) // 4 :], axis=0)
    floor = np.maximum(8 * _ROUNDING * size, np.where(flat <= 1e-11 * row, 4 * flat, 0.0))
    return int(np.max(np.flatnonzero(np.any(amplitude > floor, axis=(1, 2))), initial=0))


def _repeats_after_half(states: Array) -> bool:
    """Whether x, y change sign after half a revolution and the angles do not, within the accuracy of the orbit."""
    half = len(states) // 2
    apart = np.abs(states[half:] - _TURN * states[:half]).max(axis=0)
    size = np.abs(states).max(axis=0)
    scale = np.maximum(size[0::2], size[1::2]).repeat(2)  # x with y, θ3 with θ4
    return bool(np.all(apart <= 1e-7 * scale + 1e-300))


def _resampled(states: Array, phases: int) -> Array:
    """The states' trigonometric interpolant at more phases of a whole revolution, shape (phases, 8)."""
    have = len(states)
    if phases == have:
        return np.ascontiguousarray(states, float)
    spectrum = np.fft.rfft(states, axis=0)
    spectrum[-1] *= 0.5  # the highest cosine represents both signs of its order
    wider = np.zeros((phases // 2 + 1, 8), complex)
    wider[: len(spectrum)] = spectrum
    return np.fft.irfft(wider, phases, axis=0) * (phases / have)


def rotating_frame(
    parameters: RotorParameters,
    state: Array,
    speed_rad_s: float,
    released: tuple[bool, bool] = (True, True),
) -> PeriodicMatrix:
    """Small motions about a singular point on an isotropic suspension; A is constant in the rotating frame.

    Args:
        state: shape (8,), the space-fixed state at ψ = 0 of a motion at rest in the rotating frame.
    Raises:
        OutsideDomain: the suspension is not isotropic, or gravity lies in the disk plane.
    """
    if not parameters.is_isotropic or parameters.gravity_m_per_s2 != 0:
        raise OutsideDomain(
            "the rotating frame gives constant equations only with k1 = k2, zeta1 = zeta2 and no gravity in the disk "
            "plane; use `along`"
        )
    packed = parameters.packed()
    packed[FA] = packed[FB] = 0.0
    kept = kept_states(parameters, released)
    matrix = np.empty((8, 8))
    start = np.ascontiguousarray(state, float)
    jacobian(start, 0.0, speed_rad_s, 0.0, packed, float(2 in kept), float(3 in kept), matrix)
    matrix -= speed_rad_s * turning(8)
    return PeriodicMatrix(matrix[np.ix_(kept, kept)].astype(complex)[None], speed_rad_s, None)
