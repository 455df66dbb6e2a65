"""Life of a session: its stages, and the one table of its transitions.

    new ─open─▶ opening ─start─▶ starting ─watch─▶ watching ◀─record, end the log─▶ recording
                   └───────────────watch──────────────┘
    every stage ─close─▶ stopping ─finish─▶ closed

A session that commands the rig starts its devices; a session that only receives watches as soon as its ports are open.
The interlocks are active while the session watches or records. A log that is open when the session closes is continued
while the rotor comes to rest, and ends in the stage "stopping".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from daq.errors import AcquisitionError


class Stage(StrEnum):
    """Stage of a session."""

    NEW = "new"
    OPENING = "opening"
    STARTING = "starting"
    WATCHING = "watching"
    RECORDING = "recording"
    STOPPING = "stopping"
    CLOSED = "closed"


class Step(StrEnum):
    """Step of a session to its next stage."""

    OPEN = "open the ports"
    START = "start the devices"
    WATCH = "watch the rig"
    RECORD = "begin a log"
    END_LOG = "end a log"
    CLOSE = "close"
    FINISH = "finish"


_UNFINISHED = tuple(stage for stage in Stage if stage is not Stage.CLOSED)
TRANSITIONS: Mapping[tuple[Stage, Step], Stage] = {
    (Stage.NEW, Step.OPEN): Stage.OPENING,
    (Stage.OPENING, Step.START): Stage.STARTING,
    (Stage.OPENING, Step.WATCH): Stage.WATCHING,
    (Stage.STARTING, Step.WATCH): Stage.WATCHING,
    (Stage.WATCHING, Step.RECORD): Stage.RECORDING,
    (Stage.RECORDING, Step.END_LOG): Stage.WATCHING,
    (Stage.STOPPING, Step.END_LOG): Stage.STOPPING,
    **{(stage, Step.CLOSE): Stage.STOPPING for stage in _UNFINISHED},
    (Stage.STOPPING, Step.FINISH): Stage.CLOSED,
}
"""Stage that follows a step. A step without an entry is refused."""


@dataclass(frozen=True)
class Policy:
    """What a session may do.

    Attributes:
        commands: whether it sets up the devices and may turn the rotor. Otherwise it sends nothing and stops nothing.
        lenient: whether deviations from the rig file are only reported, as `rig check` requires.
    """

    commands: bool = True
    lenient: bool = False

    @property
    def stops(self) -> bool:
        """Whether the findings of the interlocks end the run."""
        return self.commands and not self.lenient


COMMANDING = Policy()
LISTENING = Policy(commands=False)


class Life:
    """Stage of one session.

    Attributes:
        stage: the present stage.
    """

    def __init__(self) -> None:
        self.stage: Stage = Stage.NEW

    def after(self, step: Step) -> Stage:
        """Return the stage that a step leads to.

        Raises:
            AcquisitionError: the step is impossible in the present stage.
        """
        if (following := TRANSITIONS.get((self.stage, step))) is None:
            possible = ", ".join(other for stage, other in TRANSITIONS if stage is self.stage) or "nothing"
            raise AcquisitionError(f"the session is {self.stage}, and cannot {step}; possible now: {possible}")
        return following

    def go(self, step: Step) -> Stage:
        """Take a step and return the stage that was left.

        Raises:
            AcquisitionError: the step is impossible in the present stage.
        """
        left, self.stage = self.stage, self.after(step)
        return left

    @property
    def guarding(self) -> bool:
        """Whether the interlocks are active. They are inactive while devices are opened and after they are closed."""
        return guarded(self.stage)


def guarded(stage: Stage) -> bool:
    """Return whether the interlocks are active in a stage."""
    return stage in (Stage.WATCHING, Stage.RECORDING)
