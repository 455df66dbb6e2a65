# pyright: strict
"""What an operator may ask of a running test: pause, resume, abort, a note; and what the test shows meanwhile.

Any thread may ask: a keyboard, a web page, a simulated operator. The test itself takes what was asked at its next look
and answers in `status`. A pause takes effect in the next state in which the rig may wait.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Verb = Literal["pause", "resume", "abort", "note"]


@dataclass(frozen=True)
class Request:
    """One thing asked for.

    Attributes:
        text: the reason of an abort, the text of a note.
    """

    verb: Verb
    text: str = ""


@dataclass(frozen=True)
class Status:
    """What a test is at.

    Attributes:
        test, state: its name, its state's; empty before the first.
        words: what is going on, for a person.
        share: of the state that is done, 0 … 1; None where that cannot be estimated.
        paused: whether it waits for `resume`.
        answer: to the newest request; empty when there is nothing to answer.
        numbers: the test's, as it was asked for.
    """

    test: str = ""
    state: str = ""
    words: str = ""
    share: float | None = None
    paused: bool = False
    answer: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict[str, float])


class Controls:
    """See above. One object serves one session's tests, one after the other.

    Attributes:
        status: of the running test; replaced as a whole.
    """

    def __init__(self) -> None:
        self.status = Status()
        self._asked: deque[Request] = deque()

    def pause(self) -> None:
        """Wait in the next state in which the rig may wait."""
        self._asked.append(Request("pause"))

    def resume(self) -> None:
        """Go on after a pause; takes back a pause that has not begun."""
        self._asked.append(Request("resume"))

    def abort(self, reason: str = "") -> None:
        """End the test: its log ends with the reason, the rotor comes to rest, the pendulums are locked."""
        self._asked.append(Request("abort", reason))

    def note(self, text: str) -> None:
        """Put a note into the log, with the time at which it is taken."""
        self._asked.append(Request("note", text))

    def take(self) -> list[Request]:
        """What was asked since the last time, in its order."""
        taken: list[Request] = []
        while self._asked:
            taken.append(self._asked.popleft())
        return taken
