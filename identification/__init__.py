"""Estimation of k1, k2, ζ1, ζ2, c3, c4 and S_P from recorded runs, with covariance."""

from identification.compare import ParameterComparison
from identification.compare import compare_parameters as compare_parameters
from identification.curve import FittedCurve
from identification.errors import FitFailed, IdentificationError, NotIdentifiable
from identification.estimate import Estimate
from identification.identify import Identification, NamedFit, identify
from identification.joint import ConsistencyRow, combine
from identification.pendulums.release import fit_release
from identification.pendulums.spin_down import SpinDownFit, fit_spin_down
from identification.pendulums.spin_down_run import fit_spin_down_run
from identification.pendulums.transient import TransientFit
from identification.release_check import check_releases
from identification.ring_down.equivalent import EquivalentLinear, equivalent_linear
from identification.ring_down.fit import RingDownFit, fit_ring_down, fit_ring_down_runs
from identification.run_up.fit import RunUpFit, fit_run_up, fit_run_up_run

__all__ = [
    "ConsistencyRow",
    "EquivalentLinear",
    "Estimate",
    "FitFailed",
    "FittedCurve",
    "Identification",
    "IdentificationError",
    "NamedFit",
    "NotIdentifiable",
    "ParameterComparison",
    "RingDownFit",
    "RunUpFit",
    "SpinDownFit",
    "TransientFit",
    "check_releases",
    "combine",
    "compare_parameters",
    "equivalent_linear",
    "fit_release",
    "fit_ring_down",
    "fit_ring_down_runs",
    "fit_run_up",
    "fit_run_up_run",
    "fit_spin_down",
    "fit_spin_down_run",
    "identify",
]
