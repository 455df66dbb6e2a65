"""The report: one HTML file with all a campaign found, readable without anything beside it."""

from analysis.figures.fit import FitCurve
from analysis.report.campaign import Campaign, ConsistencyCheck, Identification, IdentificationResult, TestEstimate
from analysis.report.write import render, write_report

__all__ = [
    "Campaign",
    "ConsistencyCheck",
    "FitCurve",
    "Identification",
    "IdentificationResult",
    "TestEstimate",
    "render",
    "write_report",
]
