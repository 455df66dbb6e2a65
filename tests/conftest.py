"""Shared fixtures: virtual rigs, and hypothesis settings fit for a shared two-core machine."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from functools import partial

import pytest
from hypothesis import HealthCheck, settings

from daq.acquisition.session import Session
from daq.lockstep.rig import LockstepRig
from rig_cli.simulated import VirtualRigProcess
from rig_configs import load_rig
from rig_configs.schema import Rig

from .effort import cases

settings.register_profile(
    "suite",
    deadline=None,
    max_examples=cases(30, 300),
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("suite")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the lengthy tests at the beginning: at the end one process would wait for the other."""
    items.sort(key=lambda item: item.get_closest_marker("lengthy") is None)


def pytest_collection_finish() -> None:
    """Exempt what collection left from garbage collection: each full one would take 0.4 s, dozens of times a run."""
    gc.collect()
    gc.freeze()


LATE_BEATS = "devices.drive.heartbeat_timeout_ms=800"
"""The most that is allowed: a busy machine may keep this process waiting for half a second."""


@pytest.fixture
def simulated() -> LockstepRig:
    """A virtual rig on simulated time."""
    return LockstepRig(load_rig("virtual", settings=["virtual.seed=3"]))


@pytest.fixture
def cabled(simulated: LockstepRig) -> Rig:
    """The rig file pointed at the cables of the simulated rig."""
    return load_rig("virtual", settings=simulated.port_settings())


@pytest.fixture
def virtual_rig() -> Iterator[VirtualRigProcess]:
    """A virtual rig in real time, on ptys where there are any."""
    with VirtualRigProcess("virtual", ["virtual.seed=3"]) as process:
        yield process


@pytest.fixture
def plugged(virtual_rig: VirtualRigProcess) -> Rig:
    """The rig file pointed at the virtual rig's ports."""
    return load_rig("virtual", settings=[*virtual_rig.port_settings(), LATE_BEATS])


def join(patch: pytest.MonkeyPatch, module: str, rig: LockstepRig) -> None:
    """Let the sessions that a module opens run on a simulated rig."""
    patch.setattr(f"{module}.HostClock", lambda: rig.clock)
    patch.setattr(f"{module}.Session", partial(Session, edge=rig.edge))
