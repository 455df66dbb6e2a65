"""Results of other packages converted to the report's types."""

from __future__ import annotations

from analysis.figures.fit import fit_curves
from analysis.report.campaign import Changes, ConsistencyCheck, IdentificationResult, ParameterChange, TestEstimate
from identification import Identification
from identification.compare import compare_parameters
from rig_configs import IdentifiedParameters


def report_identification(found: Identification) -> IdentificationResult:
    """Convert an identification."""
    estimates = [
        TestEstimate(e.test, e.sources, dict(zip(e.names, e.values.tolist(), strict=True)), e.std)
        for e in found.estimates
    ]
    checks = [
        ConsistencyCheck(r.parameter, r.z, f"{r.test} against the other tests, p = {r.p:.2g}")
        for r in found.consistency
    ]
    return IdentificationResult(found.parameters, estimates, checks, found.warnings, fit_curves(found.fits))


def report_changes(label: str, old: IdentifiedParameters, new: IdentifiedParameters) -> Changes:
    """Convert the changes since an earlier identification.

    Args:
        label: name of the earlier one in the report.
    """
    found = compare_parameters(old, new)
    rows = [ParameterChange(c.name, c.old, c.new, c.change, c.std, c.p_holm) for c in found.changes]
    return Changes(label, found.in_words(_LEVEL), rows, found.notes)


_LEVEL = 0.01
