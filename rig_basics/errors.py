"""The root of all errors that the packages raise on purpose, with the tree of the packages' own roots.

    RigError
    ├── DynamicsError         dynamics         a parameter outside the domain, an iteration without a result
    ├── UncertaintyError      uncertainty      an invalid source, group or measurement model
    ├── RigConfigError        rig_configs      an invalid rig file or parameters file (also a ValueError)
    ├── AcquisitionError      daq              a link, a device, a log or a guided test
    ├── IdentificationError   identification   a record without the wanted information, a fit that failed
    ├── AnalysisError         analysis         a run that is too short, no stable state, an unsuitable file name
    ├── StudyError            studies          a study that cannot be started or finished
    ├── LiveError             live             a port that is not available, a refused command
    └── ReproductionError     reproduction     an unknown item of the source, a recording that did not end

`<package>.errors` lists the errors below each root. `except RigError` catches what a user can act on; every other
exception is a defect of the software.
"""

from __future__ import annotations


class RigError(Exception):
    """Root of the errors that a user can act on. The message states what was expected, what came, and what to do."""
