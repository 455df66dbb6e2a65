"""The root of every error that this software raises on purpose.

RigError
├── RigConfigError       rig file, parameters.toml          rig_configs.errors
├── UncertaintyError     budgets, Monte Carlo               uncertainty.errors
├── DynamicsError        motion, steady states, stability   dynamics.errors
├── AcquisitionError     devices, logs, guided tests        daq.errors
├── IdentificationError  parameters from records            identification.errors
├── AnalysisError        measured against predicted         analysis.errors
├── StudyError           work in many parts                 studies.errors
├── ReproductionError    figures and claims of the source   reproduction.errors
├── LivePageError        requests of viewers and clients    live.errors
└── TestingError         conformance tests of drivers       rig_testing.report

Each package's module draws its own branch. An exception of another class is a fault of the program.
"""

from __future__ import annotations


class RigError(Exception):
    """Base of every error raised on purpose. The text states what was expected, what was found, and what to do."""
