"""Equations of motion from energies with SymPy, and the comparison of the source's printed equations with them.

They verify the compiled kernel (tests/dynamics/test_derivation.py). `dynamics` itself does not import them.
Text: docs/theory/equations_of_motion.md, docs/theory/misprints.md.
"""

from dynamics.derivation.lagrange import LagrangeEquations, lagrange_equations, rotating_frame_equations
from dynamics.derivation.linearised import (
    ISOTROPIC,
    LinearMotion,
    linearised,
    singular_point_equations,
    singular_point_matrices,
)

__all__ = [
    "ISOTROPIC",
    "LagrangeEquations",
    "LinearMotion",
    "lagrange_equations",
    "linearised",
    "rotating_frame_equations",
    "singular_point_equations",
    "singular_point_matrices",
]
