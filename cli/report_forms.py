"""Results of the packages below in the report's own types."""

from __future__ import annotations

import numpy as np

from analysis.figures.fit import FitCurve
from analysis.report.campaign import ConsistencyCheck, IdentificationResult, TestEstimate
from identification import Identification


def report_identification(found: Identification) -> IdentificationResult:
    """The identification in the report's own types."""
    estimates = [
        TestEstimate(e.test, e.source, dict(zip(e.names, e.values.tolist(), strict=True)), e.std)
        for e in found.estimates
    ]
    checks = [
        ConsistencyCheck(r.parameter, r.z, f"{r.test} against the other tests, p = {r.p:.2g}")
        for r in found.consistency
    ]
    fits = [
        FitCurve(
            f"{named.test}: {curve.label}", curve.time_s, curve.measured * scale, curve.fitted * scale, unit, label
        )
        for named in found.fits
        for curve in named.fit.curves
        for scale, unit, label in (_shown(curve.unit),)
    ]
    return IdentificationResult(found.parameters, estimates, checks, found.warnings, fits)


def _shown(unit: str) -> tuple[float, str, str]:
    return {"m": (1e3, "mm", "displacement"), "rad": (180 / np.pi, "°", "angle")}.get(unit, (1.0, unit, "value"))
