"""Status messages of a VESC on a CAN bus: their rate, and their absence while the controller answers."""

from __future__ import annotations

from daq.drivers.checks import DeviceCheck
from daq.items import DeviceEvent
from rig_basics.texts import number_of
from rig_drivers.vesc_can.settings import VescCan

_MISSING_PERIODS, _MISSING_S = 5, 0.5  # time without a status message after which they are missing: the longer one
_RATE_SHARE = 0.3  # permitted deviation of the rate of the status messages


class StatusWatch:
    """Rate of the status messages, and their absence while the controller answers.

    The absence is counted in answers, so that a stall of the host causes none. Its messages are counted as
    `missing_status` from the rate in the rig file, because they are not numbered.

    Args:
        device: name of the device in the rig file.
        losses: losses of the pipeline.
        settings: table of the controller in the rig file.

    Attributes:
        count: number of status messages so far.
    """

    def __init__(self, device: str, losses: dict[str, int], settings: VescCan) -> None:
        self.count: int = 0
        self._device, self._losses, self._rate_Hz = device, losses, settings.status_Hz
        longest_s = max(_MISSING_PERIODS / self._rate_Hz, _MISSING_S) if self._rate_Hz else 0.0
        self._max_answers = round(longest_s * settings.report_Hz)
        self._answers = self._counted = 0  # since the last status message: answers, missing messages
        self._first_ns = self._last_ns = 0
        self._missing = False
        losses["missing_status"] = 0

    @property
    def rate_Hz(self) -> float:
        """Mean rate of the status messages so far, Hz; 0 before the second one."""
        return (self.count - 1) / (self._last_ns - self._first_ns) * 1e9 if self._last_ns > self._first_ns else 0.0

    def message(self, host_ns: int) -> list[DeviceEvent]:
        """Take a status message; return the event that ends their absence."""
        self._first_ns = self._first_ns if self.count else host_ns
        self.count, self._last_ns = self.count + 1, host_ns
        missing, lost = self._missing, self._counted
        self._answers, self._counted, self._missing = 0, 0, False
        if not missing:
            return []
        return [DeviceEvent("gap", self._device, f"status messages again, about {lost} are missing", {"samples": lost})]

    def answer(self, host_ns: int) -> list[DeviceEvent]:
        """Take an answer; return the event about an absence of the status messages that has begun."""
        self._answers += 1
        if not self._rate_Hz or self._answers < self._max_answers:
            return []
        began, self._missing = not self._missing, True
        if self.count:
            lost = int((host_ns - self._last_ns) * 1e-9 * self._rate_Hz)
            self._losses["missing_status"] += max(0, lost - self._counted)
            self._counted = max(lost, self._counted)
        if not began:
            return []
        text = "no status message for" if self.count else "no status message yet in"
        text += (
            f" {number_of(self._answers, 'answer')}, expected {self._rate_Hz:g} a second (status_Hz). Look "
            f"at its setting "
            "CAN Status Messages Rate 1, or set status_Hz = 0 in the rig file"
        )
        return [DeviceEvent("status", self._device, text, {"status_messages": self.count})]


def status_check(settings: VescCan, watch: StatusWatch) -> DeviceCheck:
    """Compare the rate of the status messages with that of the rig file; their absence is accepted if it states none.

    The controller waits for a whole period after the transmission, so its rate is lower than its setting.
    """
    expected_Hz, found_Hz = settings.status_Hz, watch.rate_Hz
    fine = abs(found_Hz - expected_Hz) <= _RATE_SHARE * expected_Hz
    passed = fine or not (watch.count or "status_Hz" in settings.model_fields_set)
    advice = "set CAN Status Messages Rate 1 with status message 1 in the controller, or status_Hz in the rig file"
    return DeviceCheck(round(found_Hz, 1), f"{expected_Hz:g} ± {_RATE_SHARE:.0%}", passed, "" if fine else advice)
