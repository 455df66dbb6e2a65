"""Requests of the operator to a running test (pause, resume, abort, note), and the status of the test.

Any thread may add a request: keyboard, web page, simulated operator. The test takes the requests at its next look and
answers in `status`. A pause takes effect in the next state in which the rig may wait.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Verb = Literal["pause", "resume", "abort", "note"]


@dataclass(frozen=True)
class Request:
    """One request of the operator.

    Attributes:
        verb: kind of the request.
        text: reason of an abort, or text of a note.
    """

    verb: Verb
    text: str = ""


@dataclass(frozen=True)
class GuidedTestStatus:
    """Status of a test.

    Attributes:
        test, state: names of the test and of its state; empty before the first test.
        words: description of the progress for the operator.
        share: completed share of the state, 0 … 1; None if it cannot be estimated.
        paused: whether the test waits for `resume`.
        answer: answer to the newest request; empty without a request.
        numbers: numbers of the test, by name.
    """

    test: str = ""
    state: str = ""
    words: str = ""
    share: float | None = None
    paused: bool = False
    answer: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict[str, float])


class Controls:
    """Passes requests to the tests of one session; thread-safe.

    Attributes:
        status: status of the running test; the object is replaced with every change.
    """

    def __init__(self) -> None:
        self.status: GuidedTestStatus = GuidedTestStatus()
        self._requests: deque[Request] = deque()

    def pause(self) -> None:
        """Request a pause in the next state in which the rig may wait."""
        self._requests.append(Request("pause"))

    def resume(self) -> None:
        """Request the end of a pause. A pause that has not begun is cancelled."""
        self._requests.append(Request("resume"))

    def abort(self, reason: str = "") -> None:
        """Request the end of the test. Its log ends with the reason, the rotor is stopped, the pendulums are locked."""
        self._requests.append(Request("abort", reason))

    def note(self, text: str) -> None:
        """Request a note in the log. Its time is the time at which the test takes the request."""
        self._requests.append(Request("note", text))

    def take(self) -> list[Request]:
        """Return and remove the waiting requests in their order."""
        taken: list[Request] = []
        while self._requests:
            taken.append(self._requests.popleft())
        return taken
