"""Types of numpy arrays. Docstrings state shape and unit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Real numbers in double precision."""

Complex = NDArray[np.complex128]
"""Complex numbers in double precision."""

Bools = NDArray[np.bool_]
"""Truth values."""

Indices = NDArray[np.intp]
"""Positions in an array."""

Nanoseconds = NDArray[np.int64]
"""Times in whole nanoseconds."""
