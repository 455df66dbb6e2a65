"""Chapter 2: the rotor without a balancer, and the forces on a pendulum too light to move it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from analysis.figures.sheet import WIDTH_IN, sheet
from analysis.figures.style import GOOD, GREY, MEASURED, MODEL, label
from dynamics import Pendulum, Scene, SpeedHistory, simulate, steady_states
from dynamics.equations.parameters import RotorParameters
from dynamics.motions.frequency_response import frequency_response, light_pendulum_torque
from reproduction.results import Claim, Panel, Reproduced, SourceTable
from reproduction.workspace import ISOTROPIC, Workspace, numbers_of

_DAMPINGS = (0.05, 0.1, 0.2, 0.4, 0.7)
_SHADES = ("#440154", "#3b528b", "#21918c", "#5ec962", "#b8a000")
_SPEEDS = np.linspace(0.0, 4.0, 801)


def _rotor(work: Workspace, zeta: float) -> RotorParameters:
    """Return the isotropic rig without pendulums."""
    p = work.physics(ISOTROPIC, [f"suspension.zeta1={zeta}", f"suspension.zeta2={zeta}"])
    return replace(p, a=Pendulum.absent(), b=Pendulum.absent())


def frequency_response_2_2(work: Workspace) -> Reproduced:
    """Reproduce Figure 2.2: amplification and phase lag over the speed ratio, for several damping ratios."""
    rigs = {zeta: _rotor(work, zeta) for zeta in _DAMPINGS}
    found = {zeta: frequency_response(p, _SPEEDS) for zeta, p in rigs.items()}
    with sheet(WIDTH_IN, 5.2, "2.2: amplification and phase lag of the rotor alone") as figure:
        rows: list[Axes] = figure.subplots(2, 1, sharex=True).tolist()
        for (zeta, response), shade in zip(found.items(), _SHADES, strict=True):
            rows[0].plot(_SPEEDS, response.amplification[0], color=shade, label=f"ζ = {zeta:g}")
            rows[1].plot(_SPEEDS, np.degrees(response.lag_rad[0]), color=shade)
        rows[0].set(ylim=(0, 6))
        rows[1].set(yticks=(0, 45, 90, 135, 180), xlim=(0, 4))
        label(rows[0], None, "amplification N = |A|/e")
        label(rows[1], "speed ratio Ω = ω/ω_n", "phase lag φ, °")
    columns = {"speed_ratio": _SPEEDS}
    for zeta, response in found.items():
        columns |= {f"amplification_zeta_{zeta:g}": response.amplification[0]}
        columns |= {f"lag_deg_zeta_{zeta:g}": np.degrees(response.lag_rad[0])}
    peaks = [float(np.max(response.amplification[0])) for response in found.values()]
    at = {zeta: np.degrees(frequency_response(p, np.array([0.9, 1.0, 1.1])).lag_rad[0]) for zeta, p in rigs.items()}
    resonance = [float(lags[1]) for lags in at.values()]
    return Reproduced(
        (Panel("response", "Amplification above, phase lag below, one curve a damping ratio.", figure),),
        (SourceTable("response", "Amplification and phase lag over the speed ratio", columns),),
        numbers_of(rigs[0.05]) | {"zeta1": "0.05 … 0.7", "zeta2": "0.05 … 0.7"},
        ("The damping ratios: the source's figure names its own, its text does not.",),
        (
            Claim.judged(
                "chapter 2",
                "Amplitude and phase depend strongly on damping.",
                max(peaks) > 5 * min(peaks),
                f"largest amplification {peaks[0]:.2f} at ζ = {_DAMPINGS[0]:g}, {peaks[-1]:.2f} at {_DAMPINGS[-1]:g}; "
                f"lag at Ω = 0.9 {at[_DAMPINGS[0]][0]:.0f}° and {at[_DAMPINGS[-1]][0]:.0f}°",
            ),
            Claim.judged(
                "chapter 2",
                "At resonance the lag is 90°, for any damping.",
                max(abs(lag - 90) for lag in resonance) < 1e-9,
                f"off 90° by {max(abs(lag - 90) for lag in resonance):.0e}° at most",
            ),
            _simulated(rigs[0.1]),
            _one_argument(rigs[0.1]),
        ),
    )


def _simulated(p: RotorParameters) -> Claim:
    """Compare (2-6), (2-10) with an integration of the equations of motion."""
    worst = 0.0
    for ratio in (0.6, 1.0, 2.5):
        speed = p.speed_rad_s(ratio)
        scene = Scene(SpeedHistory.constant(speed), (False, False), np.zeros(8))
        times = np.linspace(0.0, 60 * 2 * math.pi / p.speed_rad_s(1.0), 4001)
        state = simulate(p, scene, times, 1e-6).state[-200:]
        radius = np.hypot(state[:, 0], state[:, 1]) / (p.imbalance_moment_kg_m / p.total_mass_kg)
        worst = max(
            worst, float(np.max(np.abs(radius / frequency_response(p, np.array([ratio])).amplification[0] - 1)))
        )
    return Claim.judged(
        "(2-6), (2-10)",
        "The amplification is M ω²/sqrt(ω² c² + (k − M ω²)²).",
        worst < 1e-6,
        f"integrated from rest for 60 natural periods at ζ = 0.1, Ω = 0.6, 1, 2.5: within {worst:.1e}",
    )


def _one_argument(p: RotorParameters) -> Claim:
    """Test (2-9), an arc tangent of a quotient."""
    ratio = 1.5
    speed = p.speed_rad_s(ratio)
    quotient = speed * p.damping_Ns_per_m[0] / (p.k1_N_per_m - p.total_mass_kg * speed**2)
    printed, right = (
        math.degrees(math.atan(quotient)),
        math.degrees(float(frequency_response(p, np.array([ratio])).lag_rad[0, 0])),
    )
    return Claim.judged(
        "(2-9)",
        "The lag is the arc tangent of ωc/(k − M ω²).",
        abs(printed - right) < 1e-6,
        f"at Ω = {ratio:g}, ζ = 0.1 as printed {printed:.1f}°, by both arguments {right:.1f}°: above resonance the "
        "printed form is 180° off",
    )


_CASES = (("a", "below resonance", 0.7), ("b", "at resonance", 1.0), ("c", "above resonance", 1.8))
_ZETA = 0.2
_LIGHT_KG = 1e-4
_ARROW = {"arrowstyle": "-|>", "color": MODEL, "lw": 1.2, "shrinkA": 0, "shrinkB": 0}


def forces_2_3(work: Workspace) -> Reproduced:
    """Reproduce Figure 2.3: the effect of the centrifugal field on a light pendulum at three speeds."""
    p = _rotor(work, _ZETA)
    lags = frequency_response(p, np.array([ratio for _, _, ratio in _CASES])).lag_rad[0]
    angles = np.linspace(-math.pi, math.pi, 361)
    with sheet(WIDTH_IN, 3.4, "2.3: forces on a light pendulum, seen on the rotor") as figure:
        row: list[Axes] = figure.subplots(1, 3).tolist()
        for axes, (letter, name, ratio), lag in zip(row, _CASES, lags.tolist(), strict=True):
            _draw_forces(axes, lag, f"{letter}. {name}: Ω = {ratio:g}, lag {math.degrees(lag):.0f}°")
    columns = {"angle_deg": np.degrees(angles)}
    columns |= {
        f"torque_omega_{ratio:g}": light_pendulum_torque(lag, angles)
        for (_, _, ratio), lag in zip(_CASES, lags.tolist(), strict=True)
    }
    return Reproduced(
        (
            Panel(
                "forces",
                "The disk with its imbalance on the right at three speeds. O: place of rest, about which the "
                "centrifugal field turns; C: the disk's centre. Thin arrows: what the field drives a light pendulum "
                "with along its path; filled circle: where it rests; open circle: a place with its three forces.",
                figure,
            ),
        ),
        (SourceTable("torque", "Torque over M R ω² |z| by the pendulum's angle from the imbalance", columns),),
        numbers_of(p) | {"pendulum_kg": _LIGHT_KG},
        (f"Ω = 0.7, 1, 1.8 and ζ = {_ZETA:g}: the source draws three cases and gives no numbers.",),
        tuple(
            _light_pendulum(p, ratio, lag, name) for (_, name, ratio), lag in zip(_CASES, lags.tolist(), strict=True)
        ),
    )


def _draw_forces(axes: Axes, lag: float, title: str) -> None:
    turn = np.linspace(0, 2 * math.pi, 181)
    centre = 0.45 * np.array([math.cos(-lag), math.sin(-lag)])
    axes.grid(False)
    axes.plot(centre[0] + np.cos(turn), centre[1] + np.sin(turn), color=GREY, lw=1.0)
    axes.plot(*(centre + np.array([0.8, 0.0])), "s", color="black", ms=7, label="imbalance")
    axes.plot(0, 0, "+", color="black", ms=9, mew=1.5, label="O: place of rest")
    axes.plot(*centre, "o", color=MEASURED, ms=4, label="C: disk's centre")
    for angle in np.linspace(0, 2 * math.pi, 16, endpoint=False):
        out = np.array([math.cos(angle), math.sin(angle)])
        push = float(light_pendulum_torque(lag, np.array([angle]))[0]) * 0.42 * np.array([-out[1], out[0]])
        axes.annotate("", xy=tuple(centre + out + push), xytext=tuple(centre + out), arrowprops=_ARROW)
    axes.plot(*(centre + np.array([math.cos(-lag), math.sin(-lag)])), "o", color=GOOD, ms=9, label="pendulum rests")
    _draw_three_forces(axes, centre, -lag + 1.9)
    for colour, name in ((MEASURED, "F_CF, from O"), (GREY, "F_C, along the arm"), (MODEL, "F_B, what drives it")):
        axes.plot([], [], color=colour, lw=1.6, label=name)
    axes.set(aspect="equal", xlim=(-2.1, 2.1), ylim=(-2.1, 2.1), xticks=(), yticks=())
    for spine in axes.spines.values():
        spine.set_visible(False)
    label(axes, None, None, title)


def _draw_three_forces(axes: Axes, centre: NDArray[np.float64], angle: float) -> None:
    """Return centrifugal force, constraint, and their sum along the path, at one place of the pendulum."""
    out = np.array([math.cos(angle), math.sin(angle)])
    place = centre + out
    field = 0.8 * place
    constraint = -float(field @ out) * out
    axes.plot(*place, "o", color="white", mec="black", ms=6, zorder=4)
    for force, colour in ((field, MEASURED), (constraint, GREY), (field + constraint, MODEL)):
        axes.annotate(
            "", xy=tuple(place + force), xytext=tuple(place), arrowprops=_ARROW | {"color": colour, "lw": 1.8}
        )


def _light_pendulum(p: RotorParameters, ratio: float, lag: float, name: str) -> Claim:
    """Return the rest position of a light pendulum by the whole equations, and its effect on the whirl."""
    one = replace(p, a=Pendulum(_LIGHT_KG, 0.054, 1e-4))
    speed = p.speed_rad_s(ratio)
    stable = [state for state in steady_states(one, speed, 1e-8) if state.stable]
    behind = math.degrees(-stable[0].theta_rad[0] % (2 * math.pi))
    alone = p.imbalance_moment_kg_m / one.total_mass_kg * frequency_response(one, np.array([ratio])).amplification[0, 0]
    change = stable[0].amplitude_m / float(alone) - 1
    inside = {
        "below resonance": 0 < behind < 90,
        "at resonance": abs(behind - 90) < 0.5,
        "above resonance": 90 < behind < 180,
    }[name]
    statements = {
        "below resonance": "Below resonance the pendulum rests 0° to 90° behind the imbalance and adds to it.",
        "at resonance": "At resonance it rests 90° behind and still adds, less than below.",
        "above resonance": "Above resonance it rests 90° to 180° behind and balances a part.",
    }[name]
    worse = change < 0 if name == "above resonance" else change > 0
    return Claim.judged(
        "Figure 2.3",
        statements,
        len(stable) == 1 and inside and worse and abs(behind - math.degrees(lag)) < 0.5,
        f"a pendulum of {1e3 * _LIGHT_KG:g} g at Ω = {ratio:g}, ζ = {_ZETA:g}: one stable angle, {behind:.2f}° behind "
        f"(lag {math.degrees(lag):.2f}°), amplitude changed by {1e6 * change:+.1f} millionths",
    )
