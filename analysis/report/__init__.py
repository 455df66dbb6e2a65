"""The report: one self-contained HTML file with all results of a campaign."""

from analysis.figures.fit import FitCurve
from analysis.report.campaign import (
    Campaign,
    Changes,
    ConsistencyCheck,
    IdentificationResult,
    ParameterChange,
    ReportedIdentification,
    TestEstimate,
)
from analysis.report.twin import twin
from analysis.report.write import render, write_report

__all__ = [
    "Campaign",
    "Changes",
    "ConsistencyCheck",
    "FitCurve",
    "IdentificationResult",
    "ParameterChange",
    "ReportedIdentification",
    "TestEstimate",
    "render",
    "twin",
    "write_report",
]
