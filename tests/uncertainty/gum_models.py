"""Models and data of the worked examples of JCGM 100 that JCGM 101 and 102 take up again: H.1 and H.2."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from uncertainty import ErrorSource, reliability_degrees

STANDARD_NM = 50_000_623.0
DIFFERENCE_NM = 215.0
EXPANSION = 11.5e-6
MEAN_TEMPERATURE = -0.1  # °C off 20 °C

GAUGE = [
    ErrorSource("length of the standard", 25.0, "nm", "B", "t", 18),
    ErrorSource("repeated comparisons", 13.0 / math.sqrt(5), "nm", "A", "t", 24),
    ErrorSource("comparator, random", 3.9, "nm", "B", "t", 5),
    ErrorSource("comparator, systematic", 6.7, "nm", "B", "t", 8),
    ErrorSource.of_half_width("expansion", 2e-6, "1/°C"),
    ErrorSource("mean temperature", 0.2, "°C"),
    ErrorSource.of_half_width("cyclic temperature", 0.5, "°C", "arcsine"),
    ErrorSource.of_half_width("difference of expansions", 1e-6, "1/°C", "rectangular", round(reliability_degrees(0.1))),
    ErrorSource.of_half_width("difference of temperatures", 0.05, "°C", "rectangular", round(reliability_degrees(0.5))),
]

VOLTAGE = (5.007, 4.994, 5.005, 4.990, 4.999)
CURRENT_A = (19.663e-3, 19.639e-3, 19.640e-3, 19.685e-3, 19.678e-3)
PHASE_RAD = (1.0456, 1.0438, 1.0468, 1.0428, 1.0433)
OBSERVATIONS = np.column_stack([VOLTAGE, CURRENT_A, PHASE_RAD])


def gauge_length(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Equation H.3: l = l_S + d − l_S (δα θ + α_S δθ), nm."""
    standard, d, d1, d2, expansion, mean, cyclic, d_expansion, d_temperature = errors.T
    length = STANDARD_NM + standard
    bent = d_expansion * (MEAN_TEMPERATURE + mean + cyclic) + (EXPANSION + expansion) * d_temperature
    return (length + DIFFERENCE_NM + d + d1 + d2 - length * bent)[:, None]


def impedance(errors: NDArray[np.float64]) -> NDArray[np.float64]:
    """R, X and Z in Ω of the means of voltage, current and phase."""
    voltage, current, phase = (np.mean(OBSERVATIONS, axis=0) + errors).T
    z = voltage / current
    return np.column_stack([z * np.cos(phase), z * np.sin(phase), z])
