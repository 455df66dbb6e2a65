"""Deviations of the printed equations by term: the printed term and the correct one."""

from __future__ import annotations

from dynamics.derivation.comparison import EquationComparison, comparison
from dynamics.derivation.symbols import (
    M_P,
    M_S,
    S_A,
    S_P,
    Y1,
    Y2,
    Expr,
    c1,
    c2,
    ddtheta3,
    dY1,
    dY2,
    k1,
    k2,
    normal_form,
    omega,
    psi,
    sp,
    theta3,
)

Piece = tuple[Expr, Expr]
_s, _c = sp.sin(psi), sp.cos(psi)

# Equations of several terms, in the order of their terms. Zero on the left: the term is missing in print.
PIECES: dict[str, tuple[Piece, ...]] = {
    "3-17": ((sp.Integer(0), -(omega**2) * S_P),),
    "4-6": ((sp.Integer(0), (c1 * _c**2 + c2 * _s**2) * dY1),),
    "4-7": (
        (-S_A * sp.cos(theta3) * ddtheta3, S_A * sp.cos(theta3) * ddtheta3),
        (-2 * M_P * omega * dY1, 2 * M_P * omega * dY1),
        (
            c1 * _s * (-_s * omega * Y2 - _c * (dY2 + omega * Y1)),
            c1 * _s * (_c * omega * Y2 + _s * (dY2 + omega * Y1) - _c * dY1),
        ),
        (
            c2 * _c * (-_c * omega * Y2 + _c * (dY2 + omega * Y1)),
            c2 * _c * (-_s * omega * Y2 + _c * (dY2 + omega * Y1) + _s * dY1),
        ),
        (k1 * _s * (_s * Y1 - _c * Y2), k1 * _s * (_s * Y2 - _c * Y1)),
        (k2 * _c * (_c * Y1 + _c * Y2), k2 * _c * (_s * Y1 + _c * Y2)),
    ),
    "4-10": ((sp.Integer(0), -(omega**2) * S_P),),
    "4-11": (
        (-(omega**2) * M_S * Y1, -(omega**2) * M_S * Y2),
        (omega * c2 * (_c * Y1 + _s * Y2) * _c, omega * c2 * (_c * Y1 - _s * Y2) * _c),
        (k1 * (_c * Y2 - _s * Y1) * _c, k1 * (_s * Y2 - _c * Y1) * _s),
        (k2 * (_s * Y2 + _c * Y1) * _s, k2 * (_c * Y2 + _s * Y1) * _c),
    ),
}


def unexplained(number: str) -> Expr:
    """Deviation of an equation minus its listed terms: zero if the list is complete."""
    (deviation,) = comparison(number).deviations
    return normal_form(deviation.surplus - sum(printed - right for printed, right in PIECES[number]))


def in_double_angle(expression: Expr) -> Expr:
    """Cell with cos²ψ and sinψ cosψ written in cos 2ψ and sin 2ψ, which shows its period; other cells unchanged."""
    if not expression.has(psi):
        return expression
    double = expression.subs(_s * _c, sp.sin(2 * psi) / 2).subs(_c**2, (1 + sp.cos(2 * psi)) / 2)
    return sp.collect(sp.expand(double), [sp.cos(2 * psi), sp.sin(2 * psi)])


def formula(expression: Expr) -> str:
    """LaTeX of an expression between dollar signs."""
    return f"${sp.latex(expression)}$"


def details(found: EquationComparison) -> list[str]:
    """One line of Markdown for each term or cell of a printed equation that deviates."""
    if found.number in PIECES:
        return [
            f"- missing: {formula(right)}" if printed == 0 else f"- printed {formula(printed)}, right {formula(right)}"
            for printed, right in PIECES[found.number]
        ]
    if found.number.startswith("2-") or found.number in ("3-22", "3-34"):
        return [f"- printed {formula(d.printed)}, right {formula(d.right)}" for d in found.deviations]
    return [
        f"- cell ({d.row},{d.column}): printed {formula(in_double_angle(d.printed))}, "
        f"right {formula(in_double_angle(d.right))}"
        for d in found.deviations
    ]
