# pyright: strict
"""Errors that tests share, by the label under which estimates keep them, as sources of uncertainty budgets."""

from __future__ import annotations

import re

from rig_configs.known import LABEL, KnownSource, gain_label
from rig_configs.schema import Rig
from rig_configs.suspension_terms import LABEL as TERMS_LABEL
from uncertainty import Source

STANDARD = "u"
"""Unit of a source whose standard uncertainty a parameters file does not keep: multiples of that uncertainty."""
FRICTION_LABEL = "friction"
_READ = re.compile(r"clock \S.* in ")  # a rate as one log shows it
EXACT_STEP = 1e-3
"""By how much a number without a standard uncertainty is moved where it is said what taking it as exact leaves out."""


def shared_source(label: str, rig: Rig | None = None) -> Source:
    """The source of errors kept under a label.

    A gain and a known number get standard uncertainty, type, distribution and degrees of freedom from the rig file. A
    parameters file keeps a clock's error, the friction's, and all of them where no rig file is at hand, as the shift
    for one standard deviation only: their unit is that standard deviation.

    Args:
        label: such as "gain x", "clock laser_x", "clock laser_x in 04-run-up.mcap", "friction 1" or
            "known rotor.mass_kg".
        rig: None when it is not at hand.
    """
    if rig is not None:
        for axis, std in zip("xy", rig.roles.gain_stds, strict=True):
            if label == gain_label(axis) and std > 0:
                return Source(label, std, "1")
        for known in rig.known.sources:
            if label == known.label:
                return known_source(known)
    kind = "A" if label.startswith((FRICTION_LABEL, f"{TERMS_LABEL} ")) or _READ.match(label) else "B"
    return Source(label, 1.0, STANDARD, kind)


def known_source(known: KnownSource) -> Source:
    """What a rig file takes as known, as a source under its label."""
    return Source(known.label, known.std, known.unit, known.kind, known.distribution, known.degrees_of_freedom)


def is_known(label: str) -> bool:
    """Whether a label is that of something a rig file takes as known."""
    return label.startswith(f"{LABEL} ")
