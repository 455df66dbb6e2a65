"""Checks of the encoders in addition to those of every device: their faults, and what losses mean on their bus."""

from __future__ import annotations

from collections.abc import Sequence

from daq.drivers.canopen import cia301
from daq.drivers.checks import Checks, DeviceCheck
from daq.drivers.contract import SpeedControl
from daq.items import DeviceEvent
from rig_drivers.cia406.settings import EncoderBus
from rig_drivers.cia406.stream import EncoderPipeline

_MAX_UNSAMPLED_SHARE = 0.02  # of the periods; a busy host misses a few

_FOREIGN = (
    "another node sends SYNC, and the encoders sample at its instants too: samples near them are dropped. Switch it "
    "off (1005h bit 30 of that node, or the other program)"
)
_UNASKED = (
    "an encoder has answered without or after its SYNC. Likely causes: another sender of SYNC; two encoders with one "
    "node number; an adapter that passes reports on late (its latency timer); a TPDO1 that is sent otherwise too"
)
_UNSAMPLED = (
    "this host waited for answers and sent no SYNC in these periods. Reduce rate_Hz or the latency timer of the "
    "adapter; if reports are missing too, look at slip ring and termination"
)


def emergency_words(event: DeviceEvent) -> str:
    """Return the text of an emergency; empty if it has ended."""
    code = int(event.facts["error_code"])
    return f"of encoder {event.facts['encoder']}: {cia301.emergency_words(code)}" if code else ""


def encoder_checks(
    settings: EncoderBus, pipeline: EncoderPipeline, control: SpeedControl | None, events: Sequence[DeviceEvent]
) -> Checks:
    """Return the checks of open encoders; see Driver.checks."""
    losses = pipeline.losses
    emergencies = [words for event in events if event.kind == "emergency" and (words := emergency_words(event))]
    found = list(dict.fromkeys([*emergencies, *pipeline.faults]))
    missing, unsampled = losses["reports"], losses["unsampled"]
    periods = max(1, pipeline.syncs + unsampled)
    few = unsampled <= _MAX_UNSAMPLED_SHARE * periods
    return {
        "emergencies": DeviceCheck("; ".join(found) or "none", "none", not found),
        "missing reports": DeviceCheck(missing, 0, missing == 0, "Look at bit rate and termination" * (missing > 0)),
        "foreign_syncs": _none(losses["foreign_syncs"], _FOREIGN),
        "lost_unasked": _none(losses["unasked"], _UNASKED),
        "lost_unsampled": DeviceCheck(
            unsampled, f"at most {_MAX_UNSAMPLED_SHARE:.0%} of the periods", few, "" if few else _UNSAMPLED
        ),
    }


def _none(count: int, remedy: str) -> DeviceCheck:
    return DeviceCheck(count, 0, count == 0, remedy if count else "")
