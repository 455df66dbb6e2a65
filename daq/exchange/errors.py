"""Error at the border to other programs' files."""

from daq.errors import LogError


class ExchangeError(LogError):
    """A file cannot be exported or imported as requested: bad names, units, times or text; the message has details."""
