"""Errors of the acquisition as one tree.

    AcquisitionError
    ├── LinkLost            the link to a device is lost: unplugged, powered off, port closed
    ├── DeviceError         a device answered wrongly, refused a command, or did not answer in time
    ├── LogError            a file is not a readable log, or contains invalid records
    │   └── ChannelMissing  the log is readable but has no channel of that name (also a KeyError)
    ├── RecordingError      a log cannot be written: disk full, disk removed
    └── ProcedureError      a guided test cannot continue
        └── OperatorStop    the operator stopped the rotor

Every message states what was expected, what was found, where, and what to do next.
"""

from rig_basics.errors import RigError


class AcquisitionError(RigError):
    """Base of all errors that this package raises on purpose. Other exceptions are bugs."""


class LinkLost(AcquisitionError):
    """The link to a device is lost: reading and writing fail until the device is opened again."""


class DeviceError(AcquisitionError):
    """A device answered wrongly, refused a command, or did not answer in time. Its link works."""


class LogError(AcquisitionError):
    """A file is not a readable log, or a record contradicts its header."""


class ChannelMissing(LogError, KeyError):
    """The log has no channel of the requested name. The message lists its channels and the most similar name."""

    def __str__(self) -> str:
        """Return the message without the quotes that KeyError adds."""
        return str(self.args[0]) if self.args else ""


class RecordingError(AcquisitionError):
    """A log cannot be written further. Its content up to the last flush stays readable in the .part file."""


class ProcedureError(AcquisitionError):
    """A guided test cannot continue: the condition of a step was not met, or the operator stopped it."""


class OperatorStop(ProcedureError):
    """The operator stopped the rotor from the live page. Ctrl-C in the terminal raises KeyboardInterrupt instead."""
