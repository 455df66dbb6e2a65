"""Shared fixtures: a virtual rig in its own process, and hypothesis settings fit for a shared two-core machine."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

from dynamics.compiled_code import keep_compiled_code
from rig_cli.simulated import VirtualRigProcess
from rig_configs import load_rig
from rig_configs.schema import Rig

from .effort import cases

keep_compiled_code()  # as the command does; nothing imported above compiles

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


TIME_SCALE = 5.0
LATE_BEATS = "devices.drive.heartbeat_timeout_ms=800"
"""The most that is allowed: a busy machine may keep this process waiting for half a second."""


@pytest.fixture
def virtual_rig() -> Iterator[VirtualRigProcess]:
    """A virtual rig at five times the speed of life, on ptys where there are any; its time waits for this process."""
    with VirtualRigProcess("virtual", ["virtual.seed=3"], TIME_SCALE, waits=True) as process:
        yield process


@pytest.fixture
def shared_clock(virtual_rig: VirtualRigProcess, monkeypatch: pytest.MonkeyPatch) -> VirtualRigProcess:
    """The virtual rig, whose time also waits for commands that are run in this process."""
    monkeypatch.setattr("rig_cli.guided_test.HostClock", lambda rate: virtual_rig.clock)
    return virtual_rig


@pytest.fixture
def plugged(virtual_rig: VirtualRigProcess) -> Rig:
    """The rig file pointed at the virtual rig's ports."""
    return load_rig("virtual", settings=[*virtual_rig.port_settings(), LATE_BEATS])
