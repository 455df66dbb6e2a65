"""Types of the arrays of the dynamics package, and of the tuples that its compiled functions take."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from rig_basics.arrays import Array, Complex

__all__ = ["Array", "Complex", "Flags", "Indices", "Numbers", "RealSystem", "System"]

Numbers: TypeAlias = NDArray[np.float64] | NDArray[np.complex128]
"""Argument of functions that are compiled for floats and, to carry derivatives, for complex numbers."""
Indices: TypeAlias = NDArray[np.int64]
Flags: TypeAlias = NDArray[np.bool_]
System: TypeAlias = tuple[Numbers, float, float, Array, Array, Array]
"""(packed parameters, free_a, free_b, knots, origins, cubics): RotorParameters.packed and PhaseSegments."""
RealSystem: TypeAlias = tuple[Array, float, float, Array, Array, Array]
"""`System` of functions that are compiled for floats only."""
