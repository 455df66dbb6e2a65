"""What limits a result: each parameter's variance by where it comes from.

The joint values are Σ W_i d_i. Their variance is the sum of what each test's own noise brings (W_i C_i W_iᵀ, of which a
share is there because the model leaves more than noise), what each shared error brings ((W v)²), what disagreement
between the tests adds, and what the masses' uncertainty adds to k, c and S_P, which are proportional to them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from identification.joint.combine import JointEstimate, joint_estimate
from identification.joint.provenance import model_share, rebuilt
from rig_configs.known import LABEL
from rig_configs.parameters_file import IdentifiedParameters

if TYPE_CHECKING:
    from identification.identify import Identification

SOURCES = ("noise", "model", "clock", "gain", "known", "friction", "disagreement", "mass")
_ADVICE = {
    "noise": "record longer, at a larger amplitude, or more often",
    "model": "the residuals are more than sensor noise: look at the fit, dry friction and amplitude dependence",
    "clock": "longer logs know the devices' rates better",
    "gain": "calibrate the lasers and the lever between laser and disk",
    "known": "weigh and measure the parts, set the encoders' zeros and the index angle better",
    "friction": "releases at other speeds and a spin-down know the pendulums' dry friction better",
    "disagreement": "the tests disagree: repeat them",
    "mass": "weigh the rotor",
}


@dataclass(frozen=True)
class Limit:
    """One parameter's variance by source.

    Attributes:
        name: the parameter.
        std: its standard deviation, the masses' share included, SI.
        shares: part of the variance by source, in the order of SOURCES; they sum to 1.
    """

    name: str
    std: float
    shares: dict[str, float]

    @property
    def main(self) -> str:
        """The largest source."""
        return max(self.shares, key=lambda s: self.shares[s])

    @property
    def advice(self) -> str:
        """What would make the result better, in words."""
        return _ADVICE[self.main]


def limits(of: Identification | IdentifiedParameters, mass_std: float = 0.0) -> list[Limit] | None:
    """What limits each parameter.

    Args:
        of: an identification, or a parameters file that keeps its tests.
        mass_std: relative standard uncertainty of the masses (one scale, all off alike); 0 takes the rig file's as
            exact, as the identification does.
    Returns:
        One Limit per parameter, in the file's order; None when the file keeps too little of its tests to tell.
    Source: docs/theory/joint_estimate.md.
    """
    if isinstance(of, IdentifiedParameters):
        found = rebuilt(of)
        if found is None:
            return None
        joint, model = found[0], [t.model_share for t in found[1]]
    else:
        joint = joint_estimate(of.estimates)
        model = [model_share(e, of) for e in of.estimates]
    return [_limit(i, joint, model, mass_std) for i in range(len(joint.weighted.names))]


def _limit(i: int, joint: JointEstimate, model: list[float], mass_std: float) -> Limit:
    name, together = joint.weighted.names[i], joint.weighted
    parts = dict.fromkeys(SOURCES, 0.0)
    for estimate, pull, share in zip(joint.estimates, together.pulls, model, strict=True):
        own = float(pull[i] @ estimate.covariance @ pull[i])
        parts["noise"] += own * (1 - share)
        parts["model"] += own * share
    for label, shift in together.shared.items():
        kind = label.partition(" ")[0]
        parts[kind if kind in ("clock", "friction", LABEL) else "gain"] += float(shift[i] ** 2)
    total = joint.parameters.covariance[i, i]
    parts["disagreement"] = max(0.0, float(total - sum(parts.values())))
    if not name.startswith("zeta"):
        parts["mass"] = (mass_std * joint.parameters.values[name]) ** 2
    variance = sum(parts.values())
    return Limit(name, float(np.sqrt(variance)), {s: p / variance for s, p in parts.items()})
