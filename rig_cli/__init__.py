"""The `rig` command."""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent until the program shows its log
