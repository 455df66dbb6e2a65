"""Ring-down by two libraries, if they are installed: pyOMA2 (subspace identification) and PyDMD (optimised DMD)."""

from __future__ import annotations

import contextlib
import io
import logging
from importlib import import_module
from importlib.util import find_spec

import numpy as np

from identification.bench.decays import DecayTrial
from identification.bench.ring_down_peers import answer_of_poles, block_means, strongest
from identification.bench.trials import MethodResult

INSTALL = "uv sync --group peers"
_DELAYS = 4  # snapshots stacked for the optimised DMD
_BLOCK_ROWS = 30  # of the subspace identification


def missing() -> list[str]:
    """Return the names of the libraries that are not installed."""
    return [name for name, module in (("pyOMA2", "pyoma2"), ("PyDMD", "pydmd")) if find_spec(module) is None]


def subspace_identification(record: DecayTrial) -> MethodResult:
    """Estimate by pyOMA2's covariance-driven SSI on block averages, with two states per mode."""
    algorithms, setups = import_module("pyoma2.algorithms"), import_module("pyoma2.setup")
    logging.getLogger("pyoma2").setLevel(logging.WARNING)  # without it pyOMA2 logs every step
    step, means = block_means(record)
    channels = means.shape[1]
    order = 2 * channels
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        setup = setups.SingleSetup(means - means.mean(axis=0), fs=1 / step)
        # the default limits reject a single sensor
        limits = {"xi_max": 1.0, "mpc_lim": None, "mpd_lim": None, "CoV_max": None}
        setup.add_algorithms(algorithms.SSI(name="ssi", method="cov", br=_BLOCK_ROWS, ordmax=order, step=2, hc=limits))
        setup.run_by_name("ssi")
        poles = setup["ssi"].result.Lambds[:, order // 2]
    return answer_of_poles(strongest(np.r_[poles, poles.conj()], channels))


def dynamic_mode_decomposition(record: DecayTrial) -> MethodResult:
    """Estimate by PyDMD's BOPDMD without bagging on delayed block averages."""
    step, means = block_means(record)
    rows = len(means) - _DELAYS + 1
    centred = means - means.mean(axis=0)
    delayed = np.concatenate([centred[i : i + rows].T for i in range(_DELAYS)])
    channels = means.shape[1]
    model = import_module("pydmd").BOPDMD(svd_rank=2 * channels, num_trials=0, eig_constraints={"conjugate_pairs"})
    model.fit(delayed, t=step * np.arange(rows))
    return answer_of_poles(strongest(np.asarray(model.eigs), channels))
