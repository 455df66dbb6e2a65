"""Results of the packages below in the report's own types."""

from __future__ import annotations

import numpy as np

from analysis.figures.fit import FitCurve
from analysis.report.campaign import Changes, ConsistencyCheck, IdentificationResult, ParameterChange, TestEstimate
from daq.signals.run import point_of
from identification import Identification
from identification.compare import compare
from rig_configs import IdentifiedParameters


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
            title=f"{named.test}: {curve.label}",
            time_s=curve.time_s,
            measured=curve.measured * scale,
            fitted=curve.fitted * scale,
            unit=unit,
            y_label=label,
            aside=bool(point_of(named.test)),
        )
        for named in found.fits
        for curve in named.fit.curves
        for scale, unit, label in (_shown(curve.unit),)
    ]
    return IdentificationResult(found.parameters, estimates, checks, found.warnings, fits)


def _shown(unit: str) -> tuple[float, str, str]:
    return {"m": (1e3, "mm", "displacement"), "rad": (180 / np.pi, "°", "angle")}.get(unit, (1.0, unit, "value"))


def report_changes(label: str, old: IdentifiedParameters, new: IdentifiedParameters) -> Changes:
    """What changed since an earlier identification, in the report's own types.

    Args:
        label: how the earlier one is called in the report.
    """
    found = compare(old, new)
    rows = [ParameterChange(c.name, c.old, c.new, c.change, c.std, c.p_holm) for c in found.changes]
    return Changes(label, found.in_words(_LEVEL), rows, found.notes)


_LEVEL = 0.01
