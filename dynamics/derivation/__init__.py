"""Equations of motion from energies with SymPy, and the source's printed equations held against them.

Proof of the compiled kernel (tests/dynamics/test_derivation.py). Not needed to compute a motion, so nothing of it
is imported by `dynamics` itself. Text: docs/theory/equations_of_motion.md, docs/theory/misprints.md.
"""

from dynamics.derivation.lagrange import Equations, lagrange_equations, rotating_frame_equations
from dynamics.derivation.linearised import (
    ISOTROPIC,
    LinearMotion,
    linearised,
    singular_point_equations,
    singular_point_matrices,
)

__all__ = [
    "ISOTROPIC",
    "Equations",
    "LinearMotion",
    "lagrange_equations",
    "linearised",
    "rotating_frame_equations",
    "singular_point_equations",
    "singular_point_matrices",
]
