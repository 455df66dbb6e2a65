"""List of the source's misprints, generated from the derivation: `python -m dynamics.derivation.misprints`.

Every number is computed when the list is generated. docs/book/misprints.md is the output of this module; a test
compares them.
"""

from __future__ import annotations

import textwrap

from dynamics.derivation import misprint_numbers as numbers
from dynamics.derivation.comparison import comparisons
from dynamics.derivation.definitions import definitions
from dynamics.derivation.effects import POINTS, rig
from dynamics.derivation.misprint_pieces import details
from dynamics.derivation.misprint_text import program_section, release_section, text_section
from rig_basics.texts import number_of

HEAD = """# Misprints of the source

<!-- Written by `python -m dynamics.derivation.misprints`; edit that module, not this page. -->

The source is R. Horváth, *Passive Pendulum Balancer for Rotor Systems*, dissertation, Auburn University, 2006. Its
printed equations are compared with the
[derivation from energies](../theory/equations_of_motion.md). Both are SymPy objects
(`dynamics/derivation/source_equations.py`, `lagrange.py`), compared cell by cell. The project uses none of the printed
equations.

The text was extracted from the PDF, so a changed index or sign can in principle be an error of the extraction. This is
unlikely for a cell that is wrong in chapter 3 and again in chapter 4, and for the swapped χ1, χ2 and the missing ω of
(4-16), (4-17), which occur in several cells. It is possible for single characters of (4-7), (4-11) and of the programs.

Notation is the source's, with θ3, θ4 for its Θ3, Θ4 and Y1, Y2 for its Θ1, Θ2 of chapters 3 and 4, which rotate with
the rotor; M_S is the total mass, ψ = ωt. Cells with cos²ψ and sinψ cosψ are written in cos 2ψ and sin 2ψ.
Unless stated otherwise, numbers belong to the nominal rig on the line K = 14.9 (ζ = 0.02, c34 = 0.001 N m s/rad,
S_P = 0.00254 kg m, identical pendulums of 0.075 kg) at the points """


def _matrix_row(name: str, values: tuple[float, ...], digits: int = 4) -> str:
    return "| " + " | ".join([name, *(f"{v:.{digits}f}" for v in values)]) + " |"


def _stability(values: tuple[float, ...]) -> str:
    return "".join(name for name, v in zip(POINTS, values, strict=True) if v < 1) or "no point"


def summary() -> list[str]:
    """Deviations of the equations, one line each, with the largest effect."""
    right, other = (numbers.type_i_multipliers(mass) for mass in (0.075, 0.055))
    growth = numbers.isotropic_growth_rates()
    split = growth["I, M_BB = 0.055 kg, Ω = 2.5"]
    third = growth["III, Ω = 0.8"]

    def change(name: str, point: str, values: dict[str, tuple[float, ...]], digits: int = 4) -> str:
        i = list(POINTS).index(point)
        return f"multiplier at {point} {values['derived'][i]:.{digits}f} → {values[name][i]:.{digits}f}"

    nominal = rig()
    force = nominal.imbalance_moment_kg_m * nominal.speed_rad_s(POINTS["B"]) ** 2
    alone_kg = nominal.rotor_mass_kg + nominal.imbalance_mass_kg
    torque, column = "(4-16): cells (3,2), (4,2)", "(4-17): cell (3,2)"
    swapped, no_speed = "(4-16): cells (1,1), (2,2)", "(4-17): cells (1,1), (2,2)"
    first, second = "(4-6) as printed, linearised", "(4-7) as printed, linearised"
    rows = [
        ("2-9", "arc tangent of one argument", "four-quadrant", "the lag jumps from 90° to −90° at resonance"),
        ("3-17, 4-10", "no imbalance", "−ω² S_P", f"the source's Type I leaves a force ω² S_P, at B {force:.2f} N"),
        ("3-22", "both arguments twice too large", "sine and cosine", "none: the angle of the two is the same"),
        ("3-27, 4-15 (4,1)", "sin θ3", "sin θ4", change("(4-15): cell (4,1)", "D", right)),
        ("3-28, 4-16 (3,2), (4,2)", "−2ωS sin θ", "+2ωS sin θ", change(torque, "D", right)),
        (
            "3-29, 4-17 (3,2)",
            "cos θ4",
            "cos θ3",
            f"none for identical pendulums; M_BB = 0.055 kg: "
            f"{change(column, 'B', other)}; isotropic growth rate at Ω = 2.5 {split['derived']:.3f} → "
            f"{split['(3-29)']:.3f} /s",
        ),
        (
            "3-29, 4-17 (3,3), (4,4)",
            "no ω²",
            "× ω²",
            f"none for Type I; growth rate of the stable "
            f"Type III at Ω = 0.8 {third['derived']:.3f} → {third['(3-29)']:.3f} /s",
        ),
        (
            "3-34",
            "M_D + M_P",
            "M_S",
            f"e is {100 * (nominal.total_mass_kg / alone_kg - 1):.1f} % too large, so is R_C at ρ_C = 1",
        ),
        ("4-6", "no damping of Ẏ1", "(c1 cos²ψ + c2 sin²ψ) Ẏ1", change(first, "B", right)),
        ("4-7", "six terms wrong", "see below", change(second, "B", right)),
        ("4-11", "Y1 for Y2, signs, cos ψ for sin ψ", "see below", "none for Type I; wrong for every whirl"),
        ("4-16 (1,1), (2,2)", "c1 and c2 swapped", "χ1 first, χ2 second", change(swapped, "E", right)),
        ("4-17 (1,1), (2,2)", "(c2 − c1) σ", "ω (c2 − c1) σ", change(no_speed, "A", right, 6)),
    ]
    return [
        "| equation | printed | correct | effect |",
        "|---|---|---|---|",
        *("| " + " | ".join(row) + " |" for row in rows),
    ]


def verdicts() -> list[str]:
    """One line for each numbered equation of chapters 2 to 4."""
    lines = dict[str, str]()
    for c in comparisons():
        cells = ", ".join(f"({d.row},{d.column})" for d in c.deviations) if c.subject.startswith("[") else ""
        verdict = "agrees" if c.agrees else f"**differs** {cells}".rstrip()
        lines[c.number] = f"| {c.number} | {c.subject} | {verdict} |"
    for d in definitions():
        verdict = "agrees" if d.agrees else "**differs**"
        lines[d.number] = f"| {d.number} | {d.subject} | {verdict}: {d.how} |"
    ordered = sorted(lines, key=lambda number: [int(n) for n in number.split("-")])
    return ["| equation | subject | verdict |", "|---|---|---|", *(lines[number] for number in ordered)]


def equation_details() -> list[str]:
    """Each equation that deviates, with its terms or cells."""
    lines: list[str] = []
    for c in comparisons():
        if not c.agrees:
            lines += [f"### ({c.number}) {c.subject}", *details(c), *REMARKS.get(c.number, []), ""]
    return lines


REMARKS = {
    "2-9": ["", "The lag must increase from 0° through 90° to 180°, as described in the source's chapter 2."],
    "3-17": [
        "",
        "With Y1 = Y2 = 0 the printed equations become S_A cos θ3 + S_B cos θ4 = 0 and the same for the sines: the "
        "pendulums balance each other, independent of the imbalance. The source's (3-21), (3-22) satisfy the equation "
        "with S_P.",
    ],
    "3-22": [
        "",
        "A common factor of both arguments does not change a four-quadrant arc tangent. Unlike the arguments of "
        "(3-21), they are not the sine and the cosine.",
    ],
    "3-29": ["", "Cells (3,2) to (4,4) come from (3-15), (3-16), which are printed correctly."],
    "3-34": ["", "The pendulums rotate with the rotor. Angles 180° apart belong to R_C = S_P/M_S."],
    "4-6": ["", "(4-4) and (3-13) contain the term."],
    "4-7": [
        "",
        "Dissipation (4-4) and potential (4-3) are printed correctly, and (3-14) has none of these faults. The second "
        "equation of the run-up program is also correct. The printed (4-7) was therefore not used in computations.",
    ],
    "4-11": [
        "",
        "The c1 term is correct. The spring terms are those of (4-10) with Y1 and Y2 exchanged: not equivalent.",
    ],
    "4-17": ["", "Print has M for M_S in (1,1) and (2,2). It is read as M_S."],
}


def multiplier_section() -> list[str]:
    """Largest multipliers with each printed cell."""
    head = ["| matrices | " + " | ".join(POINTS) + " | stable at |", "|---|" + "---|" * (len(POINTS) + 1)]
    lines = [
        "Largest modulus of the Type I multipliers over one revolution: derived matrices with the named printed cells.",
        "Values below 1 are stable. The stable points should be B, C, E.",
    ]
    for title, mass in (("Identical pendulums", 0.075), ("M_BB = 0.055 kg", 0.055)):
        lines += ["", f"**{title}**", "", *head]
        lines += [
            _matrix_row(name, v)[:-1] + f"| {_stability(v)} |" for name, v in numbers.type_i_multipliers(mass).items()
        ]
    lines += ["", "Isotropic (K = 1, ζ = 0.05): largest real part of the eigenvalues in 1/s, stable below 0.", ""]
    growth = numbers.isotropic_growth_rates()
    names = list(next(iter(growth.values())))
    lines += ["| singular point | " + " | ".join(names) + " |", "|---|" + "---|" * len(names)]
    lines += [_matrix_row(case, tuple(values.values()), 3) for case, values in growth.items()]
    same = numbers.type_i_multipliers(0.075)["(4-15), (4-16), (4-17) as printed"]
    whole = numbers.type_i_multipliers(0.055)["(4-15), (4-16), (4-17) as printed"]
    return [
        *lines,
        "",
        f"All printed together: stable at {_stability(same)} with identical pendulums, so the source's maps alone do "
        f"not show whether they were computed with them; at {_stability(whole)} with M_BB = 0.055 kg.",
    ]


def text() -> str:
    """Text of docs/book/misprints.md."""
    points = ", ".join(f"{name} (Ω = {ratio})" for name, ratio in POINTS.items())
    wrong = sum(not c.agrees for c in comparisons())
    vague = sum(not d.agrees for d in definitions())
    parts = [
        HEAD + points + ".",
        "## Equations: summary",
        "\n".join(summary()),
        "## Everything compared",
        f"{len(comparisons())} equations and matrices are compared cell by cell, {wrong} of them differ. The other "
        f"{number_of(len(definitions()), 'numbered item')} are definitions and methods: each is verified by a property "
        f"that an incorrect one would not have (`dynamics/derivation/definitions.py`); {vague} of them fails.",
        "\n".join(verdicts()),
        "## Equations: details",
        "\n".join(equation_details()).rstrip(),
        "## Effect of the printed matrices",
        "\n".join(multiplier_section()),
        "## Programs of the source",
        "\n".join(program_section()),
        "## The run-up program's two faults, measured",
        "\n".join(release_section()),
        "## Contradictions within the text and with its tables",
        "\n".join(text_section()),
    ]
    return "\n".join(_wrapped(line) for line in "\n\n".join(parts).split("\n")) + "\n"


def _wrapped(line: str) -> str:
    """Prose wrapped at 120 characters; tables, headings and formulas unchanged."""
    if len(line) <= 120 or line.startswith(("|", "#")) or "$" in line:
        return line
    indent = "  " if line.startswith("- ") else ""
    return textwrap.fill(line, 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


if __name__ == "__main__":
    print(text(), end="")
