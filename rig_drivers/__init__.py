"""Drivers of devices other than those of the rig itself, found by entry points as those of any other package."""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent until the program shows its log
