"""Multipliers of the balanced state in ball arithmetic: a reference that shares no code with the rest of the package.

The computation starts from the stored parameters, with as many bits as the enclosure needs: the balanced angles (as
sines and cosines, from the triangle's sides), the linear equations in the frame that turns with the rotor,

    M_S a + suspension = Σ S_i [(2ω θ̇_i − iθ̈_i) + iω² θ_i] e^{iθ_i0},     a = z̈ + 2iω ż − ω² z,
    J_i θ̈_i = S_i (a_x sin θ_i0 − a_y cos θ_i0) − c_i θ̇_i,

whose mass matrix is constant and whose suspension contains only cos 2ψ and sin 2ψ, and their fundamental matrix over
half a revolution. Two methods compute it:

- `taylor`: with τ = tan(ψ − ψ0) the equations become (1 + τ²)² dY/dτ = (P0 + P1 τ + P2 τ²) Y, so the Taylor series
  obeys a recurrence of five terms. Rounding and truncation are enclosed: the result is proven.
- `collocation`: Radau polynomials on panels, for modes that decay too fast for a series. The multipliers of the
  slowly decaying modes converge geometrically, independent of the fast ones. The error is estimated from two
  resolutions: it is observed, not proven.

python-flint is a development dependency. It is imported at the first use.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from scipy.special import roots_jacobi

from dynamics.arrays import Complex
from dynamics.equations.parameters import Pendulum, RotorParameters
from dynamics.errors import NotConverged, OutsideDomain
from rig_basics.texts import number_of

_MAX_DECAY = 45.0  # decay exponent over half a revolution; a faster mode is below e^−90 after a whole one
_SMALLEST_BITS = 256
_STEP_RATE = 60.0  # norm × step of a Taylor panel
_LARGEST_TAU = 0.25  # the series converges for |τ| < 1
_STAGES = 16
_TAYLOR_PANEL_S, _COLLOCATION_PANEL_S = 0.03, 0.25  # measured on one core of an AMD EPYC (Zen 4)
_PANEL_RATE = 7.0  # rate × panel of a collocation polynomial of _STAGES stages


@dataclass(frozen=True)
class Reference:
    """The largest multiplier of the balanced state.

    Attributes:
        largest: largest modulus over one revolution.
        error: bound on its error, relative to max(1, largest); proven for "taylor", observed for "collocation".
        moduli: all moduli over one revolution, largest first.
        theta_rad: balanced angles θ3, θ4 in [0, 2π), the ones with θ3 ≤ π.
        method: "taylor" or "collocation".
    """

    largest: float
    error: float
    moduli: tuple[float, ...]
    theta_rad: tuple[float, float]
    method: str


def flint() -> Any:
    """The flint module.

    Raises:
        ImportError: it is not installed.
    """
    try:
        return importlib.import_module("flint")
    except ImportError as missing:
        raise ImportError(
            "the reference in ball arithmetic needs python-flint, which is not installed: pip install python-flint"
        ) from missing


def balanced_directions(parameters: RotorParameters) -> list[tuple[Any, Any]]:
    """(cos θ, sin θ) of θ3 and θ4 as balls, from the stored moments; θ3 in [0, π].

    A moment within one rounding of the border counts as on the border, as in dynamics.equations.balancing.

    Raises:
        OutsideDomain: the three moments do not form a triangle.
    """
    arb = flint().arb
    sides = (
        parameters.a.first_moment_kg_m,
        parameters.b.first_moment_kg_m,
        parameters.imbalance_moment_kg_m,
    )
    a, b, p = (Fraction(s) for s in sides)
    rounding = Fraction(math.ulp(max(sides)))
    gaps = [max(g, Fraction(0)) if g >= -rounding else g for g in (b + p - a, a + p - b, a + b - p)]
    if min(gaps) < 0:
        raise OutsideDomain(f"no balanced state: the moments {sides} kg m form no triangle; choose S_P between them")
    if p == 0:
        return [(arb(0), arb(1)), (arb(0), arb(-1))]
    found: list[tuple[Any, Any]] = []
    for near, far, sign in (
        (gaps[0] * gaps[2], gaps[1] * (a + b + p), 1),
        (gaps[1] * gaps[2], gaps[0] * (a + b + p), -1),
    ):
        whole = near + far
        cosine, square = (far - near) / whole, 4 * near * far / whole**2  # of the angle between imbalance and pendulum
        found.append((-_ball(cosine), sign * _ball(square).sqrt()))  # the pendulum lies opposite: θ = π ∓ that angle
    return found


def _ball(value: Fraction | float) -> Any:
    """Ball that encloses an exact number."""
    module, exact = flint(), Fraction(value)
    return module.arb(module.fmpq(exact.numerator, exact.denominator))


@dataclass(frozen=True)
class _System:
    """dY/dψ = (mean + even cos 2ψ + odd sin 2ψ) Y with arb matrices, scaled to entries of similar size."""

    mean: Any
    even: Any
    odd: Any
    dimension: int

    def at(self, phase: Any) -> Any:
        """The matrix at a phase given as a ball."""
        return self.mean + self.even * (2 * phase).cos() + self.odd * (2 * phase).sin()

    def rates(self) -> Complex:
        """Eigenvalues at twelve phases, per radian of rotor phase, in double precision."""
        arb = flint().arb
        n = self.dimension
        found: list[Complex] = []
        for phase in np.linspace(0.0, math.pi, 12, endpoint=False):
            entries = self.at(arb(float(phase)))
            square = np.array([[float(entries[i, j]) for j in range(n)] for i in range(n)])
            found.append(np.asarray(np.linalg.eigvals(square), np.complex128))
        return np.concatenate(found)


def _system(parameters: RotorParameters, speed_rad_s: float) -> _System:
    """Equations of the balanced state: state (Y1, Y2, R θ3, R θ4) and rates divided by a common rate."""
    if parameters.gravity_m_per_s2 != 0 or parameters.pivot_shift_m != 0:
        raise OutsideDomain("the reference covers a disk at rest: expected no gravity and no pivot shift")
    module = flint()
    arb, matrix = module.arb, module.arb_mat
    directions = balanced_directions(parameters)
    w, mass = _ball(speed_rad_s), _ball(parameters.total_mass_kg)
    k = [_ball(parameters.k1_N_per_m), _ball(parameters.k2_N_per_m)]
    ratios = (parameters.zeta1, parameters.zeta2)
    c = [2 * _ball(z) * (own * mass).sqrt() for z, own in zip(ratios, k, strict=True)]
    free = [i for i, p in enumerate((parameters.a, parameters.b)) if p.present]
    bodies = [_body(p) for p in (parameters.a, parameters.b)]
    half = 2 + len(free)
    masses = matrix(half, half)
    masses[0, 0] = masses[1, 1] = mass
    force = {name: matrix(half, 2 * half) for name in ("mean", "even", "odd")}  # right-hand sides against the state
    for name, stiffness, damping in (
        ("mean", (k[0] + k[1]) / 2, (c[0] + c[1]) / 2),
        ("even", (k[0] - k[1]) / 2, (c[0] - c[1]) / 2),
        ("odd", (k[0] - k[1]) / 2, (c[0] - c[1]) / 2),
    ):
        mirror = {"mean": ((1, 0), (0, 1)), "even": ((1, 0), (0, -1)), "odd": ((0, -1), (-1, 0))}[name]
        for i in range(2):  # −Rᵀ K R z − Rᵀ C R (ż + ω i z)
            force[name][i, 0] = -stiffness * mirror[i][0] - damping * w * mirror[i][1]
            force[name][i, 1] = -stiffness * mirror[i][1] + damping * w * mirror[i][0]
            force[name][i, half], force[name][i, half + 1] = -damping * mirror[i][0], -damping * mirror[i][1]
    for place, which in enumerate(free):
        s, j, loss, _ = bodies[which]
        (cos, sin), row = directions[which], 2 + place
        masses[0, row], masses[1, row] = -s * sin, s * cos
        masses[row, 0], masses[row, 1], masses[row, row] = -s * sin, s * cos, j
        force["mean"][0, row], force["mean"][1, row] = -s * w * w * sin, s * w * w * cos
        force["mean"][0, half + row], force["mean"][1, half + row] = 2 * s * w * cos, 2 * s * w * sin
        force["mean"][row, half + row] = -loss
    accelerations = {name: masses.solve(f) for name, f in force.items()}
    mean = accelerations["mean"]
    mean[0, 0] += w * w  # z̈ = a − 2iω ż + ω² z
    mean[1, 1] += w * w
    mean[0, half + 1] += 2 * w
    mean[1, half] -= 2 * w
    pace = max(*parameters.natural_frequencies_rad_s, speed_rad_s)
    scale = [arb(1), arb(1), *(bodies[i][3] for i in free)]
    scale += [length / _ball(pace) for length in scale]
    whole = {}
    for name, lower in accelerations.items():
        square = matrix(2 * half, 2 * half)
        for i in range(half):
            if name == "mean":
                square[i, half + i] = _ball(pace) / w
            for col in range(2 * half):
                square[half + i, col] = lower[i, col] * scale[half + i] / scale[col] / w
        whole[name] = square
    return _System(whole["mean"], whole["even"], whole["odd"], 2 * half)


def _body(pendulum: Pendulum) -> tuple[Any, Any, Any, Any]:
    """S, J, c, R. S is the stored, rounded product, because it decides the borders of the balancing region."""
    arm = _ball(pendulum.length_m)
    rolling = 1 + _ball(pendulum.ball_inertia_ratio if pendulum.ball_radius_m > 0 else 0.0)
    inertia = _ball(pendulum.mass_kg) * arm * arm * rolling
    return _ball(pendulum.first_moment_kg_m), inertia, _ball(pendulum.damping_Nms_per_rad), arm


def _norm(square: Any) -> float:
    """Upper bound of the largest row sum of absolute values."""
    n = square.nrows()
    return max(sum(float(abs(square[i, j]).upper()) for j in range(square.ncols())) for i in range(n)) * (1 + 1e-12)


def _taylor_panel(system: _System, start: Any, tau: Any) -> Any:
    """The fundamental matrix from phase ψ0 to ψ0 + atan τ, enclosed."""
    matrix, n = flint().arb_mat, system.dimension
    cos, sin = (2 * start).cos(), (2 * start).sin()
    even, odd = system.even * cos + system.odd * sin, system.odd * cos - system.even * sin
    parts = (system.mean + even, 2 * odd, system.mean - even)
    sizes, t = [_norm(p) for p in parts], float(tau.upper())
    small = 2.0 ** (-min(flint().ctx.prec, 1000))
    identity = matrix(n, n, [int(i == j) for i in range(n) for j in range(n)])
    terms = [matrix(n, n), matrix(n, n), matrix(n, n), identity]  # Y_{n−3} … Y_n, times τ^n
    steps = [p * tau ** (i + 1) for i, p in enumerate(parts)]
    square, fourth = tau * tau, tau**4
    total, order = identity, 0
    while True:
        rest = steps[0] * terms[3] + steps[1] * terms[2] + steps[2] * terms[1]
        rest -= terms[2] * (2 * (order - 1) * square) + terms[0] * ((order - 3) * fourth)
        order += 1
        terms = [*terms[1:], rest / order]
        total += terms[3]
        share = (sizes[0] * t + sizes[1] * t**2 + sizes[2] * t**3) / (order + 1) + 2 * t**2 + t**4
        if share < 0.5 and order % 8 == 0:  # from here the ratio of the next term to the last four only decreases
            largest = max(_norm(term) for term in terms)
            if largest < small:
                tail = flint().arb(0, 4 * share * largest / (1 - share))
                return total + matrix(n, n, [tail] * (n * n))


def _taylor(system: _System, panels: int) -> Any:
    """The fundamental matrix over half a revolution, enclosed."""
    pi = flint().arb.pi()
    tau, product = (pi / panels).tan(), None
    for i in range(panels):
        panel = _taylor_panel(system, pi * i / panels, tau)
        product = panel if product is None else panel * product
    return product


def _collocation(system: _System, panels: int) -> Any:
    """The fundamental matrix over half a revolution from Radau polynomials on equal panels."""
    module = flint()
    arb, matrix, n, s = module.arb, module.arb_mat, system.dimension, _STAGES
    nodes = [arb(0), *_radau_nodes(s)]
    slopes = _differentiation(nodes)
    width, product = arb.pi() / panels, None
    for panel in range(panels):
        large, right = matrix(n * s, n * s), matrix(n * s, n)
        for i in range(s):
            here = system.at(width * (panel + nodes[i + 1])) * width
            for a in range(n):
                for b in range(n):
                    large[i * n + a, i * n + b] = -here[a, b]
                for j in range(s):
                    large[i * n + a, j * n + a] += slopes[i + 1][j + 1]
                right[i * n + a, a] = -slopes[i + 1][0]
        solved = large.solve(right)
        last = matrix(n, n, [solved[(s - 1) * n + a, b].mid() for a in range(n) for b in range(n)])
        product = last if product is None else last * product
    return product


def _radau_nodes(stages: int) -> list[Any]:
    """Nodes in (0, 1], the last one 1: zeros of P_{s−1} − P_s. Newton's method refines double-precision values."""
    module = flint()
    legendre = [module.arb_poly([1]), module.arb_poly([0, 1])]
    for n in range(1, stages):
        legendre.append(
            (module.arb_poly([0, 2 * n + 1]) * legendre[n] - n * legendre[n - 1]) * (module.arb(1) / (n + 1))
        )
    zero_at = legendre[stages - 1] - legendre[stages]
    slope, nodes = zero_at.derivative(), list[Any]()
    for start in roots_jacobi(stages - 1, 1, 0)[0]:
        x = module.arb(float(start))
        for _ in range(7):
            x = (x - zero_at(x) / slope(x)).mid()
        nodes.append((x + 1) / 2)
    return [*nodes, module.arb(1)]


def _differentiation(nodes: list[Any]) -> list[list[Any]]:
    """Derivatives at the nodes of the Lagrange polynomials of the nodes."""
    weights: list[Any] = []
    for i, here in enumerate(nodes):
        product = flint().arb(1)
        for j, there in enumerate(nodes):
            if i != j:
                product *= here - there
        weights.append(1 / product)
    rows = [
        [weights[j] / weights[i] / (a - b) if i != j else None for j, b in enumerate(nodes)]
        for i, a in enumerate(nodes)
    ]
    return [[-sum(r for r in row if r is not None) if entry is None else entry for entry in row] for row in rows]


def _largest(half: Any) -> tuple[float, float, tuple[float, ...]]:
    """Largest modulus over one revolution, its error relative to max(1, modulus), and all moduli."""
    try:
        values = flint().acb_mat(half).eig(multiple=True)
    except ValueError:  # usual: Jordan blocks: neutral drift at the borders of the balancing region
        values = _around_roots(half)
    found = [abs(value) ** 2 for value in values]
    highest, lowest = max(float(m.upper()) for m in found), max(float(m.lower()) for m in found)
    middle = (highest + lowest) / 2
    error = (highest - lowest) / 2 + 4 * math.ulp(middle)
    return middle, error / max(1.0, middle), tuple(sorted((float(m.mid()) for m in found), reverse=True))


def _around_roots(square: Any) -> list[Any]:
    """Eigenvalues that may be defective, enclosed through the characteristic polynomial.

    The roots of two monic polynomials whose coefficients differ by d_k can be paired within
    (2n − 1) (Σ |d_k| γ^k)^{1/n}, γ twice the largest |coefficient|^{1/order} (Ostrowski; R. Bhatia, Matrix Analysis,
    section VIII.2). The bound is coarse and needs n times the bits.
    """
    module, n = flint(), square.nrows()
    own = module.acb_poly([module.acb(c) for c in square.charpoly().coeffs()])
    near = [module.acb(v.real.mid(), v.imag.mid()) for v in module.acb_mat(square).eig(algorithm="approx")]
    product = module.acb_poly([1])
    for root in near:
        product *= module.acb_poly([-root, 1])
    sizes = [abs(poly[n - k]).upper().root(k).upper() for poly in (own, product) for k in range(1, n + 1)]
    gamma = 2 * max(sizes, key=float)
    apart: Any = sum((abs(own[k] - product[k]).upper() * gamma**k for k in range(n)), module.arb(0))
    radius = ((2 * n - 1) * module.arb(apart).upper().root(n)).upper()
    around = module.arb(0, radius)
    return [module.acb(root.real + around, root.imag + around) for root in near]


def _proven(parameters: RotorParameters, speed_rad_s: float, panels: int) -> tuple[float, float, tuple[float, ...]]:
    """Result of `_largest` from the Taylor series, with more bits until the enclosure is below 1e-14."""
    context, width = flint().ctx, math.inf
    for spare in (1, 3, 9):
        context.prec = (_SMALLEST_BITS + math.ceil(1.5 * _STEP_RATE) + 2 * panels) * spare
        found = _largest(_taylor(_system(parameters, speed_rad_s), panels))
        width = found[1]
        if width < 1e-14:
            return found
    raise NotConverged(
        f"reference: the multipliers are enclosed to {width:.2g} with {number_of(context.prec, 'bit')}, expected 1e-14"
    )


def _observed(system: _System, panels: int) -> tuple[float, float, tuple[float, ...]]:
    """Result of `_largest` from collocation, with its error from a second resolution."""
    flint().ctx.prec = _SMALLEST_BITS + 128
    coarse = _largest(_collocation(system, panels))
    finer = _largest(_collocation(system, math.ceil(1.3 * panels) + 1))
    return finer[0], abs(finer[0] - coarse[0]) / max(1.0, finer[0]) + finer[1], finer[2]


def reference(
    parameters: RotorParameters, speed_rad_s: float, seconds: float = 20.0, method: str | None = None
) -> Reference:
    """Largest multiplier of the balanced state, with as many bits as the enclosure needs.

    Args:
        parameters: properly oversized pendulums, without gravity and pivot shift.
        speed_rad_s: running speed, rad/s.
        seconds: longest predicted computing time, s.
        method: "taylor" or "collocation". None: the method with the lower predicted time.
    Raises:
        OutsideDomain: the balanced state does not exist.
        NotConverged: no method is predicted to finish in time, or the enclosure stays too wide.
        ImportError: python-flint is not installed.
    """
    context = flint().ctx
    before, context.prec = context.prec, _SMALLEST_BITS
    try:
        system = _system(parameters, speed_rad_s)
        angles = [math.atan2(float(sin), float(cos)) % (2 * math.pi) for cos, sin in balanced_directions(parameters)]
        size = sum(_norm(part) for part in (system.mean, system.even, system.odd))
        panels = math.ceil(math.pi / min(math.atan(_LARGEST_TAU), _STEP_RATE / size))
        rates = system.rates()
        slow = np.abs(rates[np.real(rates) * math.pi > -_MAX_DECAY])
        long = max(2, math.ceil(float(np.max(slow, initial=1.0)) * math.pi / _PANEL_RATE))
        costs = {
            "taylor": panels * _TAYLOR_PANEL_S * (1 + panels / 300),
            "collocation": 2.3 * long * _COLLOCATION_PANEL_S,
        }
        chosen = method or min(costs, key=lambda name: costs[name])
        if costs[chosen] > seconds:
            raise NotConverged(
                f"reference: {panels} Taylor panels or {long} of collocation would take {costs[chosen]:.3g} s, "
                f"more than {seconds:.3g} s; allow more time"
            )
        found = _proven(parameters, speed_rad_s, panels) if chosen == "taylor" else _observed(system, long)
    finally:
        context.prec = before
    return Reference(*found, (angles[0], angles[1]), chosen)
