"""What can go wrong on the rig, as one tree.

    RigError
    ├── LinkLost            a device is gone: unplugged, powered off, its port closed
    ├── DeviceError         a device answered wrongly, refused, or did not answer in time
    ├── LogError            a file is not a readable log, or holds what a log may not hold
    │   └── ChannelMissing  the log is fine but has no such channel (also a KeyError)
    ├── RecordingError      a log cannot be written: disk full, disk gone
    └── ProcedureError      a guided test cannot go on
        └── OperatorStop    the operator stopped the rotor

Every text says what was expected, what came, where, and what to do next.
"""


class RigError(Exception):
    """Base of everything this package raises on purpose; catch it to tell a rig trouble from a bug."""


class LinkLost(RigError):
    """A device is gone: reading or writing its byte link fails and waiting will not help."""


class DeviceError(RigError):
    """A device answered wrongly, refused a command, or did not answer in time; the link itself works."""


class LogError(RigError):
    """A file is not a readable log, or a record in it cannot be what its header says."""


class ChannelMissing(LogError, KeyError):
    """The log has no channel of the wanted name; the text lists those it has and the nearest one."""

    def __str__(self) -> str:
        """The plain text; a bare KeyError would show it quoted."""
        return str(self.args[0]) if self.args else ""


class RecordingError(RigError):
    """A log cannot be written any further; what was written until then stays readable in its .part file."""


class ProcedureError(RigError):
    """A guided test cannot go on: a step's condition was not met, or the operator stopped it."""


class OperatorStop(ProcedureError):
    """The operator stopped the rotor, by something else than the terminal's Ctrl-C: the live page's button."""
