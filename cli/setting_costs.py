# pyright: strict
"""placeholder."""

TRACKING_HELP = "fast or reference"
