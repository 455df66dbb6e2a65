"""Samples of a drive as rows, for the tests of drives."""

from collections.abc import Iterable

from daq.items import Batch, DeviceEvent


def rows(items: Iterable[Batch | DeviceEvent]) -> list[tuple[float, float, int]]:
    """Speed, set-point (rpm) and statusword of each sample."""
    out: list[tuple[float, float, int]] = []
    for item in items:
        if isinstance(item, Batch):
            names = ("speed_rpm", "target_rpm", "statusword")
            out += zip(*(item.columns[name].tolist() for name in names), strict=True)
    return out
