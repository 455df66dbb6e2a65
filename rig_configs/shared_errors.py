"""Errors that tests share, by their labels in estimates, as sources of uncertainty budgets."""

from __future__ import annotations

from rig_configs.error_label import ErrorLabel
from rig_configs.known import KnownSource
from rig_configs.schema import Rig
from uncertainty import ErrorSource

STANDARD = "u"
"""Unit of a source whose standard uncertainty is not stored in a parameters file: multiples of that uncertainty."""
EXACT_STEP = 1e-3
"""Relative change of a number without a standard uncertainty, for the statement on its effect."""


def shared_source(label: ErrorLabel, rig: Rig | None = None) -> ErrorSource:
    """Return the source of errors with a label.

    A gain and a known number have standard uncertainty, type, distribution and degrees of freedom from the rig file. A
    parameters file contains the error of a clock, of friction, and without a rig file of all labels, only as the shift
    per standard deviation. The unit is then that standard deviation.

    Args:
        label: label of the errors.
        rig: rig file, or None.
    """
    if rig is not None:
        for axis, std in zip("xy", rig.roles.gain_stds, strict=True):
            if label == ErrorLabel("gain", axis) and std > 0:
                return ErrorSource(label.text, std, "1")
        for known in rig.known.sources:
            if label == known.label:
                return known_source(known)
    kind = "A" if label.kind in ("friction", "suspension") or label.log else "B"
    return ErrorSource(label.text, 1.0, STANDARD, kind)


def known_source(known: KnownSource) -> ErrorSource:
    """Return a known number of a rig file as a source with its label."""
    freedom = known.degrees_of_freedom
    return ErrorSource(known.label.text, known.std, known.unit, known.kind, known.distribution, freedom)
