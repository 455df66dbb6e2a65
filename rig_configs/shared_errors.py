"""Errors that tests share, by their labels in estimates, as sources of uncertainty budgets."""

from __future__ import annotations

import re

from rig_configs.known import LABEL, KnownSource, gain_label
from rig_configs.schema import Rig
from rig_configs.suspension_terms import LABEL as TERMS_LABEL
from uncertainty import ErrorSource

STANDARD = "u"
"""Unit of a source whose standard uncertainty is not stored in a parameters file: multiples of that uncertainty."""
FRICTION_LABEL = "friction"
_READ = re.compile(r"clock \S.* in ")  # clock rate in one log
EXACT_STEP = 1e-3
"""Relative change of a number without a standard uncertainty, for the statement on its effect."""


def shared_source(label: str, rig: Rig | None = None) -> ErrorSource:
    """Return the source of errors with a label.

    A gain and a known number have standard uncertainty, type, distribution and degrees of freedom from the rig file. A
    parameters file contains the error of a clock, of friction, and without a rig file of all labels, only as the shift
    per standard deviation. The unit is then that standard deviation.

    Args:
        label: for example "gain x", "clock laser_x", "clock laser_x in 04-run-up.mcap", "friction 1" or
            "known rotor.mass_kg".
        rig: rig file, or None.
    """
    if rig is not None:
        for axis, std in zip("xy", rig.roles.gain_stds, strict=True):
            if label == gain_label(axis) and std > 0:
                return ErrorSource(label, std, "1")
        for known in rig.known.sources:
            if label == known.label:
                return known_source(known)
    kind = "A" if label.startswith((FRICTION_LABEL, f"{TERMS_LABEL} ")) or _READ.match(label) else "B"
    return ErrorSource(label, 1.0, STANDARD, kind)


def known_source(known: KnownSource) -> ErrorSource:
    """Return a known number of a rig file as a source with its label."""
    return ErrorSource(known.label, known.std, known.unit, known.kind, known.distribution, known.degrees_of_freedom)


def is_known(label: str) -> bool:
    """Whether a label belongs to a known number of a rig file."""
    return label.startswith(f"{LABEL} ")
