"""Fixed steps of a motion with dry friction, for a simulated rig whose time step is much shorter than a slide.

Each step has one mode per pendulum (dynamics.equations.friction): it slides forward, slides backward, or sticks. Modes
change between steps. A pendulum whose speed changes sign within a step is stopped at its end, at most one step late. A
pendulum at rest slides in the next step if the torque that would hold it exceeds friction. In contrast, `simulate`
locates these instants and bounds its error; docs/theory/integration.md.
"""

from __future__ import annotations

import numpy as np

from dynamics.arrays import Array
from dynamics.compiled_code import compiled
from dynamics.equations.friction import needed_torque
from dynamics.equations.kernels import FA, rk4_step
from dynamics.equations.parameters import RotorParameters
from dynamics.equations.scene import Scene
from dynamics.equations.speed_history import phase_at
from dynamics.errors import OutsideDomain


@compiled(part=True)
def choose_modes(y: Array, phase: Array, p: Array, free: Array, modes: Array, scratch: Array) -> None:
    """Write the mode of each pendulum in the next step to modes: 1 forward, −1 backward, 0 sticking.

    A locked pendulum or one without friction has the mode 1; the packed friction then has no effect.

    Args:
        y: state, shape (8,).
        phase: (ψ, ω, α) at the step's start.
        p: packed parameters, friction not negative.
        free: shape (2,), 1.0 for a released pendulum.
        modes: shape (2,), written.
        scratch: shape (8,).
    """
    for i in range(2):
        modes[i] = 1.0
        if free[i] != 0.0 and p[FA + i] != 0.0:
            modes[i] = 0.0 if y[6 + i] == 0.0 else np.sign(y[6 + i])
    for i in range(2):
        if modes[i] != 0.0:
            continue
        free_a, free_b = free[0] * abs(modes[0]), free[1] * abs(modes[1])
        torque = needed_torque(i, y, phase[0], phase[1], phase[2], p, free_a, free_b, scratch)
        if abs(torque) > p[FA + i] * phase[1] * phase[1]:
            modes[i] = np.sign(torque)


@compiled(part=True)
def friction_step(
    y: Array,
    h: float,
    phase0: Array,
    phase1: Array,
    phase2: Array,
    p: Array,
    free: Array,
    modes: Array,
    signed: Array,
    k1: Array,
    k2: Array,
    k3: Array,
    k4: Array,
    work: Array,
) -> None:
    """Advance y by h in place with dry friction, otherwise as `rk4_step`.

    Args:
        p: packed parameters, friction not negative.
        free: shape (2,), 1.0 for a released pendulum.
        modes, signed: scratch, shapes (2,) and that of p; signed[...] = p[...] before the first step.
    """
    choose_modes(y, phase0, p, free, modes, work)
    for i in range(2):
        signed[FA + i] = p[FA + i] * (-1.0 if modes[i] < 0.0 else 1.0)
    free_a, free_b = free[0] * abs(modes[0]), free[1] * abs(modes[1])
    rk4_step(y, h, phase0, phase1, phase2, signed, free_a, free_b, k1, k2, k3, k4, work)
    for i in range(2):
        if free[i] != 0.0 and p[FA + i] != 0.0 and y[6 + i] * modes[i] <= 0.0:
            y[6 + i] = 0.0


@compiled(nogil=True)
def _march(
    y: Array, times: Array, h: float, knots: Array, coefficients: Array, p: Array, free: Array, out: Array
) -> None:
    """Write states at the times to out, shape (n, 8), by equal steps of at most h between them."""
    scratch, phases = np.empty((5, 8)), np.empty((3, 3))
    modes, signed = np.empty(2), p.copy()
    segment = 0
    out[0] = y
    for i in range(1, len(times)):
        count = max(1, int(np.ceil((times[i] - times[i - 1]) / h)))
        step = (times[i] - times[i - 1]) / count
        for k in range(count):
            at = times[i - 1] + k * step
            for j in range(3):
                segment = phase_at(at + 0.5 * j * step, segment, knots, coefficients, phases[j])
            friction_step(
                y,
                step,
                phases[0],
                phases[1],
                phases[2],
                p,
                free,
                modes,
                signed,
                scratch[0],
                scratch[1],
                scratch[2],
                scratch[3],
                scratch[4],
            )
        out[i] = y


def fixed_states(parameters: RotorParameters, scene: Scene, time_s: Array, step_s: float) -> Array:
    """Motion by fixed steps, without an error bound: for motions that cannot be computed to an accuracy.

    Args:
        parameters: parameters of the rotor.
        scene: scene with a start state and without later releases.
        time_s: instants, ascending, beginning with that of the start state, shape (n,).
        step_s: longest step, s.
    Returns:
        States, shape (n, 8).
    Raises:
        OutsideDomain: the scene has no start state, or later releases.
    """
    if scene.start is None or scene.release_time_s is not None:
        raise OutsideDomain("fixed_states: expected a scene with a start state and free pendulums")
    out = np.empty((len(time_s), 8))
    y = np.array(scene.start, np.float64)
    free = np.array([float(flag) for flag in scene.released])
    times = np.asarray(time_s, np.float64)
    packed = parameters.packed()
    _march(y, times, step_s, scene.history.knots_s, scene.history.coefficients, packed, free, out)
    return out
