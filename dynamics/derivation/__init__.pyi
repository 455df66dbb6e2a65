"""Public names of `dynamics.derivation`; each is imported at its first use."""

from .lagrange import (
    LagrangeEquations as LagrangeEquations,
    lagrange_equations as lagrange_equations,
    rotating_frame_equations as rotating_frame_equations,
)
from .linearised import (
    ISOTROPIC as ISOTROPIC,
    LinearMotion as LinearMotion,
    linearised as linearised,
    singular_point_equations as singular_point_equations,
    singular_point_matrices as singular_point_matrices,
)
