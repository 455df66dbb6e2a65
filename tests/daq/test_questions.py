"""Questions of a dialogue are repeated until they are answered."""

from __future__ import annotations

from daq.drivers.questions import ask
from daq.transports.host_clock import HostClock


class Line:
    """An open device that answers the request of a number with some replies."""

    def __init__(self, answers: dict[int, list[str]]) -> None:
        self.clock, self.answers, self.sent = HostClock(), answers, 0
        self.replies = self.clock.queue()
        self.bytes_in = 0
        self.replies.put("5")  # late, to an earlier request

    def send(self, data: bytes) -> None:
        self.sent += 1
        for reply in self.answers.get(self.sent, []):
            self.replies.put(reply)

    def restart_decoding(self) -> None:
        """Nothing is decoded."""


def number_in(reply: str) -> int | None:
    return int(reply) if reply.isdigit() else None


def test_a_question_is_repeated_until_a_fitting_reply_comes() -> None:
    line = Line({2: ["words", "7", "8"]})
    assert ask(line, b"?", number_in, 0.01, 3) == 7
    assert line.sent == 2
    assert ask(line, b"?", number_in, 0.01, 2) is None
    assert line.sent == 4
