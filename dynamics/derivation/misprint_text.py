"""Faults of the source's programs and contradictions in its text, with their computed effects, as Markdown lines."""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import numpy as np

from dynamics.derivation import misprint_numbers as numbers
from dynamics.derivation.run_up_faults import SCRIPT_SPEED_RAD_S, ReleaseMotion, script_rig

_Row: TypeAlias = tuple[str, str, str]
_GENERATING: Final[tuple[_Row, ...]] = (
    (
        "generating program",
        "pendulum A is placed with the turn by θ4",
        "θ3 would have no inertia and the inertia matrix no inverse, so the program was not run in this form; one "
        "character (II, III), possibly an error of the extraction",
    ),
    (
        "generating program",
        "cell (1,4) of the inertia matrix is filled from cell (1,3)",
        "−S_A sin θ3 for −S_B sin θ4; multipliers above. The cell is written to one output file only; the run-up "
        "program uses the equations themselves",
    ),
    (
        "generating program",
        "the first derivative is stored under another name than it is read by",
        "the program stops; one character",
    ),
)


def program_section() -> list[str]:
    """The generating program, the run-up program and the two stability programs."""
    rows = (*_GENERATING, *_run_up_rows(), *_program_rows())
    return ["| program | content | effect |", "|---|---|---|", *(f"| {a} | {b} | {c} |" for a, b, c in rows)]


def _run_up_rows() -> list[_Row]:
    rig = script_rig()
    ratio = SCRIPT_SPEED_RAD_S / rig.natural_frequencies_rad_s[0]
    return [
        (
            "run-up program",
            "the equations, with the rotor's acceleration",
            "agree with the derivation, all four (compared symbolically)",
        ),
        ("run-up program", "Θ̈1, Θ̈2 are evaluated before Θ̈3, Θ̈4 exist", "fault (a), next section"),
        ("run-up program", "locked: the angles are held, their rates integrate", "fault (b), next section"),
        (
            "run-up program",
            "pendulum A's torque divided by M_A R_A² under a name that is not defined",
            "the program stops; one character, possibly an error of the extraction",
        ),
        (
            "run-up program",
            "no run-up: full speed from the first instant, the disk at rest",
            "contradicts the title; the transient decays before the release",
        ),
        ("run-up program", "speed commented as hertz", "2π·20 is in rad/s: 1200 rpm"),
        (
            "run-up program",
            "M_P twice 120.9 g and called a part of M_D, yet added to it",
            f"S_P = {rig.imbalance_moment_kg_m:.5f} kg m, twice the appendix's; M_S {rig.total_mass_kg:.3f} kg",
        ),
        (
            "run-up program",
            "500 N/m, 10 N s/m",
            f"f_n = {rig.natural_frequencies_rad_s[0] / 2 / math.pi:.2f} Hz, not 3 Hz; ζ = {rig.zeta1:.3f}; "
            f"it runs at Ω = {ratio:.1f}",
        ),
        (
            "run-up program",
            "plots Θ1, Θ2 of the rotating frame together with laser readings",
            "a steady whirl is constant in that frame and a sine at the space-fixed sensors; the plotted θ3, θ4 have "
            "the opposite sign",
        ),
    ]


def _program_rows() -> list[_Row]:
    error, sampling = numbers.piecewise_errors(100)
    fine, _ = numbers.piecewise_errors(400)
    border, shift = numbers.border_shift()
    same = "to 1e-12" if sampling < 1e-12 else f"to {sampling:.0e}"
    return [
        (
            "piecewise program",
            "samples [A] at the ends of the pieces, the text at their middles",
            f"none: the multipliers are the same {same}; error at A, B, E with 100 pieces "
            + ", ".join(f"{e:.1e}" for e in error)
            + ", with 400 "
            + ", ".join(f"{e:.1e}" for e in fine),
        ),
        (
            "piecewise program",
            "counts a multiplier below 1 + 1e-5 as stable, the other program below 1 + 1e-8",
            f"the border of the first stable zone, Ω = {border:.5f}, moves by {shift:.1e}",
        ),
        (
            "single-pass program",
            "fills the matrix from a variable that does not exist",
            "the program stops; with the correct variable it stores the transpose, whose eigenvalues are the same",
        ),
        ("both", "integrate a whole revolution", "the period is half a revolution: twice the work"),
    ]


def _release_row(place: str, name: str, run: ReleaseMotion, right: ReleaseMotion) -> str:
    before = slice(run.released - 50, run.released)
    speeds = run.speed_at_release_rad_s
    angles = np.degrees(run.final_angles_rad) % 360
    difference = math.degrees(numbers.largest_angle_difference_rad(run, right))
    cells = (
        place,
        name,
        f"{speeds[0] + 0.0:.2f}, {speeds[1] + 0.0:.2f}",
        f"{1e3 * math.sqrt(np.mean(run.radius_m[before] ** 2)):.3f}",
        f"{1e3 * np.max(run.radius_m[run.released :]):.3f}",
        "–" if run is right else f"{difference:.1f}",
        f"{run.settling_time_s():.1f}",
        f"{angles[0]:.1f}, {angles[1]:.1f}",
    )
    return "| " + " | ".join(cells) + " |"


def release_section() -> list[str]:
    """Effect of faults (a) and (b) on a release."""
    lines = [
        "Settings: full speed from the first instant, disk at rest, pendulums locked at 0° and 180° + 0.001 rad for "
        "12 s, as in the program; then free for 60 s instead of its 10 s. Runge–Kutta of order 4, 200 steps a "
        "revolution. The project's equations with the faults (`dynamics/derivation/run_up_faults.py`); without faults "
        "they are equal to the compiled kernel. The last place has the program's own numbers.",
        "",
        "| at | equations | θ̇3, θ̇4 at release, rad/s | rms radius before, mm | largest radius after, mm "
        "| largest angle difference, ° | settled within 1° after, s | final θ3, θ4, ° |",
        "|---|---|---|---|---|---|---|---|",
    ]
    releases = numbers.releases()
    for place, runs in releases.items():
        right = runs["right equations"]
        lines += [_release_row(place, name, run, right) for name, run in runs.items()]
    d = releases["D"]
    gap = math.degrees(d["(a) no push back"].final_angles_rad[0] - d["right equations"].final_angles_rad[0])
    wobble = math.degrees(numbers.wobble_rad(d["right equations"]))
    a = numbers.type_i_multipliers(0.075)["run-up script: no push back"]
    ends = all(_same_end(runs) for runs in releases.values())
    return [
        *lines,
        "",
        f"- Every run ends in the same type {'and the same mirror image ' if ends else ''}as the right equations. "
        "If the pendulums come to rest on the rotor (B, the program's rig) the angles are equal: at rest θ̈ = 0.",
        f"- If they oscillate (A, D: amplitude {wobble:.1f}° at D, twice a revolution) fault (a) omits a part of the "
        f"torque permanently: θ3 at D is {gap:.1f}° off.",
        f"- Stability: with fault (a) the largest Type I multiplier at A–E is {', '.join(f'{v:.4f}' for v in a)}: the "
        "same points are stable.",
        "- With fault (b) the false speed loads the disk while the pendulum is locked. The radius before release is "
        "therefore wrong, and the pendulums leave their unstable start earlier. Much of the angle difference is this "
        "shift in time, and the motion after the release appears faster than it is.",
    ]


def _same_end(runs: dict[str, ReleaseMotion]) -> bool:
    right = np.exp(1j * runs["right equations"].final_angles_rad)
    return all(bool(np.max(np.abs(np.exp(1j * run.final_angles_rad) - right)) < 0.1) for run in runs.values())


def text_section() -> list[str]:
    """Sentences that contradict the source's own tables, numbers or equations."""
    rows = [*_stability_rows(), *_whirl_rows(), *_data_rows()]
    return ["| place | statement | correct |", "|---|---|---|", *(f"| {a} | {b} | {c} |" for a, b, c in rows)]


def _stability_rows() -> list[tuple[str, str, str]]:
    types = numbers.stable_types()
    found = "; ".join(
        f"{region}: {'/'.join(types[region, 0.8])} below resonance, {'/'.join(types[region, 2.5])} above"
        for region in numbers.REGIONS
    )
    slip, radius = numbers.slip_without_imbalance()
    return [
        (
            "summary of 3.1",
            "below resonance Type II alone is stable",
            f"Type III, as in its Tables 3.3 and 3.4. Computed (K = 1, ζ = 0.02, Ω = 0.8 and 2.5): {found}",
        ),
        (
            "summary of 3.1",
            "oversized and above resonance: Type III, independent of damping",
            "Type I if properly, Type II if improperly oversized, as in Table 3.4",
        ),
        (
            "summary of 3.1",
            "undersized below resonance: no damping dependence",
            "correct for its existence; the angle of Type III depends on damping: sin(θ + φ_H) = −(S_T/S_P) sin φ_H",
        ),
        (
            "3.2.2",
            "below resonance Type III whirls even without imbalance",
            "below S_P = (S_A + S_B) sin φ_H Type III does not exist: "
            f"{1e3 * numbers.least_moment_of_type_iii():.3f} g m at Ω = 0.8, ζ = 0.05 (the source's own singular point "
            f"loss). With almost no imbalance the pendulums whirl together at {1e3 * radius:.2f} mm but slip "
            f"by {abs(slip):.2f} rad/s: they do not reach a steady state on the rotor",
        ),
        ("conclusions", "near resonance Types II and III lose stability", "they cease to exist, as in its chapter 3"),
        (
            "(3-7)",
            "improperly oversized pendulums may help if the difference S_A − S_B is below S_P",
            "that difference is above S_P in this region by (3-5). Far above resonance they reduce the amplitude while "
            "it is below 2 S_P: amplitude over that without pendulums at Ω = 6 "
            f"{numbers.type_ii_against_none(0.75):.2f} for S_P = 0.75 of the difference, "
            f"{numbers.type_ii_against_none(0.4):.2f} for 0.4",
        ),
        ("3.1", "insufficiently oversized", "improperly oversized"),
    ]


def _whirl_rows() -> list[tuple[str, str, str]]:
    slips = numbers.slip_revolutions()
    largest = numbers.largest_multipliers()
    real = ", ".join(name for name, value in largest.items() if abs(value.imag) < 1e-6 * abs(value))
    pairs = ", ".join(f"{name} ({value:.3f})" for name, value in largest.items() if name not in real)
    return [
        (
            "4.1",
            "Types II and III satisfy (4-10) to (4-13) on different springs",
            "they do not: ψ does not cancel unless Y1 = Y2 = 0. The motions are periodic: "
            f"θ3 at D varies by {math.degrees(numbers.wobble_rad(numbers.releases()['D']['right equations'])):.1f}°",
        ),
        (
            "4.4, conclusions",
            "where Type I is unstable, Type III becomes stable",
            f"not always: at D with ζ = 0.05 the pendulums slip by {abs(slips[0]):.0f} and {abs(slips[1]):.0f} turns "
            "in 60 s",
        ),
        (
            "4.1.4",
            "the largest multipliers are a conjugate pair",
            f"at {real} the largest one is real, a pair only at {pairs}; possibly correct for other parameters",
        ),
        ("4.1.1", "[Φ0] = [I] at every t; [C] = [Φ0(0)]", "[Φ0(0)] = [I]; [C] = [Φ0(T)]; arguments lost in print"),
        ("4.1.3", "start vectors: 1×8 columns; the results are columns", "8×1; the program stores rows"),
        (
            "chapters 2, 3, 4",
            "Θ1, Θ2 for the disk centre",
            "in the space-fixed frame in chapter 2 and in all measurements, in the turning frame in the equations of "
            "chapters 3 and 4",
        ),
    ]


def _data_rows() -> list[tuple[str, str, str]]:
    quick, slow, endless = numbers.settling_times_s((1e-3, 1e-2, 50.0))
    return [
        (
            "3.3",
            "speed almost 20 times the critical one",
            "1200 rpm over 3 Hz (appendix A) is 6.7; with the program's 500 N/m it is 15.3",
        ),
        ("appendix A", "length of pendulums 0.054 mm", "0.054 m, as in the program"),
        (
            "appendix A",
            "c34 = 0.01 to 50 N s m/rad",
            "N mm s/rad: chapter 4 has 0.001, the program 0.0005 N m s/rad. In N m s/rad the slowest motion at B would "
            f"take {slow:.0f} s (0.01) to {endless / 86400:.0f} days (50) to fall by e; at 0.001 {quick:.1f} s",
        ),
        ("appendix A", "final speed 150 to 1200 rpm", "the ball balancer was run at 1500 rpm"),
        ("nomenclature", "D is a sum of dissipation energies", "Rayleigh's function: half the power lost, W"),
        (
            "nomenclature",
            "T for period and kinetic energy, A for matrix, amplitude and a factor of (3-21)",
            "distinguished by context",
        ),
        ("3.3.2", "F_C for the centrifugal force, F_CS for the constraint", "F_CF and F_C by the nomenclature"),
        (
            "3.1, 3.2, 3.3",
            "Tables 1–4, figure 6, Figure 3.24 compared with itself",
            "Tables 3.1–3.4, Figure 3.2, Figure 3.24 with 3.22",
        ),
        (
            "1.1",
            "ring balancer of Ledyard and Leblanc's balancer 1896; Clark 1946",
            "1916, 1916 and 1940 in its bibliography (1946 fits the patent number)",
        ),
    ]
