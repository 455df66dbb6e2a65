"""Variance of each joint parameter, split by source.

The joint values are Σ W_i d_i. Their variance is the sum of the contributions of each test's own noise (W_i C_i W_iᵀ,
a share of it due to residuals beyond the noise), of each shared error ((W v)²), of disagreement between the tests, and
of the masses' uncertainty, to which k, c and S_P are proportional.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from identification.joint.combine import JointEstimate, joint_estimate
from identification.joint.provenance import model_share, rebuilt
from rig_configs.parameters_file import IdentifiedParameters

if TYPE_CHECKING:
    from identification.identify import Identification

Source = Literal["noise", "model", "clock", "gain", "known", "friction", "disagreement", "mass"]
SOURCES: tuple[Source, ...] = ("noise", "model", "clock", "gain", "known", "friction", "disagreement", "mass")
_SOURCE_OF: Mapping[str, Source] = {
    "clock": "clock",
    "friction": "friction",
    "known": "known",
    "slow roll": "model",
    "suspension": "model",
}
_ADVICE = {
    "noise": "record longer, at a larger amplitude, or more often",
    "model": "the residuals are more than sensor noise: look at the fit, dry friction and amplitude dependence",
    "clock": "longer logs determine the devices' clock rates better",
    "gain": "calibrate the lasers and the lever between laser and disk",
    "known": "weigh and measure the parts, set the encoders' zeros and the index angle better",
    "friction": "releases at other speeds and a spin-down determine the pendulums' dry friction better",
    "disagreement": "the tests disagree: repeat them",
    "mass": "weigh the rotor",
}


@dataclass(frozen=True)
class ParameterLimit:
    """Variance of one parameter by source.

    Attributes:
        name: parameter.
        std: standard deviation including the contribution of the masses, SI.
        shares: share of the variance by source, in the order of SOURCES. The shares sum to 1.
    """

    name: str
    std: float
    shares: dict[str, float]

    @property
    def main(self) -> str:
        """Source with the largest share."""
        return max(self.shares, key=lambda s: self.shares[s])

    @property
    def advice(self) -> str:
        """Advice how to reduce the largest share."""
        return _ADVICE[self.main]


def limits(of: Identification | IdentifiedParameters, mass_std: float = 0.0) -> list[ParameterLimit] | None:
    """Split the variance of each parameter by source.

    Args:
        of: identification, or parameters file that contains its tests.
        mass_std: relative standard uncertainty of the masses, taken as one common scale error; 0 takes the masses of
            the rig file as exact, as the identification does.
    Returns:
        One Limit per parameter, in the file's order; None if the file does not contain its tests.
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


def _limit(i: int, joint: JointEstimate, model: list[float], mass_std: float) -> ParameterLimit:
    name, together = joint.weighted.names[i], joint.weighted
    parts = dict.fromkeys(SOURCES, 0.0)
    for estimate, pull, share in zip(joint.estimates, together.pulls, model, strict=True):
        own = float(pull[i] @ estimate.covariance @ pull[i])
        parts["noise"] += own * (1 - share)
        parts["model"] += own * share
    for label, shift in together.shared.items():
        source: Source = _SOURCE_OF.get(label.kind, "gain")
        parts[source] += float(shift[i] ** 2)
    total = joint.parameters.covariance[i, i]
    parts["disagreement"] = max(0.0, float(total - sum(parts.values())))
    if not name.startswith("zeta"):
        parts["mass"] = (mass_std * joint.parameters.values[name]) ** 2
    variance = sum(parts.values())
    return ParameterLimit(name, float(np.sqrt(variance)), {s: p / variance for s, p in parts.items()})
