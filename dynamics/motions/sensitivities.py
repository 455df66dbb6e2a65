"""Derivatives of a motion by parameters and start state, through differentiation of the integrator's arithmetic.

The steps of the run that meets the accuracy are recorded. Explicit steps are repeated with complex numbers, one
parameter shifted by iε. The imaginary part over ε is the derivative of the computed result, exact to rounding, because
the square of ε = 10⁻³⁰ vanishes. Implicit steps are differentiated through their stage equations: the stages are known,
so their derivatives solve one linear system for all parameters.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynamics.arrays import Array, Complex, Numbers, RealSystem, System
from dynamics.compiled_code import compiled
from dynamics.equations.kernels import C1, C2, CA, CB, FA, FB, K1, K2, MASS, PACKED, SP, rates
from dynamics.equations.parameters import RigOrParameters, RotorParameters, physics_of
from dynamics.equations.phase_segments import PhaseSegments, phase_within, segment_of
from dynamics.equations.scene import Scene
from dynamics.errors import OutsideDomain
from dynamics.motions.explicit_steps import evaluate, explicit_polynomial, explicit_step
from dynamics.motions.implicit_steps import NODES, differentiate_stages, implicit_polynomial
from dynamics.motions.integrate import simulate
from dynamics.motions.locked_motion import locked_state_derivatives
from dynamics.motions.motion import Motion, Piece, Polynomials
from dynamics.motions.motion_problem import instants
from rig_basics.thread_pool import ThreadPool

_EPSILON = 1e-30


def sensitivities(
    parameters: RigOrParameters,
    scene: Scene,
    time_s: ArrayLike,
    names: Sequence[str],
    accuracy: float = 1e-6,
    method: str | None = None,
) -> tuple[Motion, Array]:
    """Simulate a motion and its derivatives.

    If the scene has no start state, the derivatives include the dependence of the locked orbit on the parameters.

    Args:
        parameters: the rig, or its rotor parameters.
        scene, time_s, accuracy, method: as for dynamics.motions.integrate.simulate.
        names: any of k1_N_per_m, k2_N_per_m, zeta1, zeta2, c3_Nms_per_rad, c4_Nms_per_rad, SP_kg_m, and start_0 …
            start_7 for a component of the start state.
    Returns:
        The motion, and ∂state/∂parameter in SI, shape (len(time_s), 8, len(names)).
    Raises:
        OutsideDomain: an unknown name, or dry friction (the instants of its mode changes depend on the parameters).
        NotConverged: as for simulate.
    """
    physics, times = physics_of(parameters), instants(time_s)
    if np.any(physics.packed()[[FA, FB]] != 0.0):
        raise OutsideDomain("sensitivities hold for motion without dry friction; set friction_arm_m to 0")
    directions = _directions(physics, scene, float(times[0]), names)
    motion = simulate(physics, scene, times, accuracy, method, dense=True, resolved=True)
    out = np.zeros((len(times), 8, len(names)))
    if motion.polynomials is None:  # zero duration
        out[:] = directions[1].T
        return motion, out
    arrays = PhaseSegments.of(scene.history).arrays[:3]
    repeat = _repeat_implicit if motion.method == "implicit" else _repeat_explicit

    def part_of(group: NDArray[np.intp]) -> Array:
        return repeat(motion, times, directions[0][group], directions[1][group], arrays)

    workers = max(1, min(len(names), os.cpu_count() or 1))
    groups = np.array_split(np.arange(len(names)), workers)
    with ThreadPool(workers) as pool:
        for group, part in zip(
            groups,
            pool.map(part_of, groups),
            strict=True,
        ):
            out[:, :, group] = part
    return motion, out


def packed_derivatives(parameters: RotorParameters) -> dict[str, Array]:
    """∂(RotorParameters.packed)/∂(identified parameter), each of shape (26,): c = 2 ζ sqrt(k M_S) by the chain rule."""
    p = parameters.packed()
    unit = np.eye(len(p))
    return {
        "k1_N_per_m": unit[K1] + unit[C1] * p[C1] / (2 * p[K1]),
        "k2_N_per_m": unit[K2] + unit[C2] * p[C2] / (2 * p[K2]),
        "zeta1": unit[C1] * 2 * np.sqrt(p[K1] * p[MASS]),
        "zeta2": unit[C2] * 2 * np.sqrt(p[K2] * p[MASS]),
        "c3_Nms_per_rad": unit[CA],
        "c4_Nms_per_rad": unit[CB],
        "SP_kg_m": unit[SP],
    }


def _directions(physics: RotorParameters, scene: Scene, begin: float, names: Sequence[str]) -> tuple[Array, Array]:
    """Derivatives of packed parameters, shape (n, 26), and of the start state, shape (n, 8), by each name."""
    packed, starts = packed_derivatives(physics), {}
    if scene.start is None:
        psi, speed, _ = PhaseSegments.of(scene.history).phase(begin)
        starts = locked_state_derivatives(physics, speed, psi, 0.0, np.pi)
    components = {f"start_{i}": np.eye(8)[i] for i in range(8)}
    unknown = [n for n in names if n not in packed and n not in components]
    if unknown:
        raise OutsideDomain(f"no sensitivity to {unknown}; known are {[*packed, *components]}")
    return (
        np.array([packed.get(n, np.zeros(PACKED)) for n in names]).reshape(len(names), PACKED),
        np.array([components.get(n, starts.get(n, np.zeros(8))) for n in names]).reshape(len(names), 8),
    )


def _clear_locked_rates(start: Numbers, piece: Piece) -> None:
    """Set the start rate of a locked pendulum to zero."""
    start[..., 6] *= piece.free_a
    start[..., 7] *= piece.free_b


def _repeat_explicit(
    motion: Motion, times: Array, packed: Array, starts: Array, arrays: tuple[Array, Array, Array]
) -> Array:
    kept, pieces = _kept(motion)
    out = np.zeros((len(times), 8, len(packed)))
    for column in range(len(packed)):
        y = kept.coefficients[0, 0] + 1j * _EPSILON * starts[column]
        _clear_locked_rates(y, pieces[0])
        states = np.empty((len(times), 8), dtype=np.complex128)
        done = _write_until(times, kept.spans[0, 0], states, y, 0)
        for piece in pieces:
            p = piece.packed + 1j * _EPSILON * packed[column]
            end = kept.spans[piece.last, 0] if piece.last < len(kept.spans) else kept.end_s
            system = (p, piece.free_a, piece.free_b, *arrays)
            done = _explicit_again(y, kept.spans[piece.first : piece.last], end, system, times, done, states)
        out[:, :, column] = states.imag / _EPSILON
    return out


def _repeat_implicit(
    motion: Motion, times: Array, packed: Array, starts: Array, arrays: tuple[Array, Array, Array]
) -> Array:
    kept, pieces = _kept(motion)
    dy = starts.copy()
    _clear_locked_rates(dy, pieces[0])
    out = np.zeros((len(times), len(packed), 8))
    done = 0
    while done < len(times) and times[done] <= kept.spans[0, 0]:
        out[done] = dy
        done += 1
    for piece in pieces:
        part = slice(piece.first, piece.last)
        system = (piece.packed, piece.free_a, piece.free_b, *arrays)
        done = _implicit_again(dy, kept.spans[part], kept.coefficients[part], system, packed, times, done, out)
    return np.swapaxes(out, 1, 2)


def _kept(motion: Motion) -> tuple[Polynomials, tuple[Piece, ...]]:
    assert motion.polynomials is not None
    return motion.polynomials, motion.polynomials.pieces


def _write_until(times: Array, begin: float, states: Numbers, y: Numbers, done: int) -> int:
    while done < len(times) and times[done] <= begin:
        states[done] = y
        done += 1
    return done


@compiled(part=True)
def _last_segment(end: float, segment: int, knots: Array) -> int:
    while segment < len(knots) and knots[segment] < end:
        segment += 1
    return segment


@compiled(nogil=True)
def _explicit_again(
    y: Complex, spans: Array, end_s: float, system: System, times: Array, done: int, states: Complex
) -> int:
    """Repeat recorded steps with a complex state, shape (8,), advanced in place; returns the number of samples."""
    p, free_a, free_b, knots, origins, cubics = system
    k, polynomial = np.zeros((16, 8), dtype=np.complex128), np.zeros((8, 8), dtype=np.complex128)
    end, work = np.empty(8, dtype=np.complex128), np.empty(8, dtype=np.complex128)
    phase, segment = np.empty(3), 0
    for step in range(len(spans)):
        t, h = spans[step]
        segment = segment_of(t, segment, knots)
        last = _last_segment(t + h, segment, knots)
        phase_within(t, segment, last, knots, origins, cubics, phase)
        rates(y, phase[0], phase[1], phase[2], p, free_a, free_b, k[0])
        explicit_step(y, t, h, segment, last, system, k, end, phase)
        reach = spans[step + 1, 0] if step + 1 < len(spans) else end_s
        if done < len(times) and times[done] <= reach:
            explicit_polynomial(y, end, t, h, segment, last, system, k, work, phase, polynomial)
            while done < len(times) and times[done] <= reach:
                evaluate(polynomial, (times[done] - t) / h, states[done])
                done += 1
        y[:] = end
    return done


@compiled(nogil=True)
def _implicit_again(
    dy: Array, spans: Array, coefficients: Array, system: RealSystem, packed: Array, times: Array, done: int, out: Array
) -> int:
    """Propagate derivatives, shape (n, 8), through recorded implicit steps; returns the number of samples."""
    knots = system[3]
    dz, polynomial = np.empty((len(dy), 5, 8)), np.zeros((8, 8))
    z, segment = np.empty((5, 8)), 0
    for step in range(len(spans)):
        t, h = spans[step]
        segment = segment_of(t, segment, knots)
        last = _last_segment(t + h, segment, knots)
        for s in range(5):
            evaluate(coefficients[step], NODES[s], z[s])
        differentiate_stages(z, t, h, segment, last, system, packed, dy, dz)
        first, written = done, done
        for column in range(len(dy)):
            implicit_polynomial(dy[column], dz[column], polynomial)
            written = first
            while written < len(times) and times[written] <= t + h:
                evaluate(polynomial, (times[written] - t) / h, out[written, column])
                written += 1
            dy[column] += dz[column, 4]
        done = written
    return done
