"""The source's figures, tables and claims, reproduced and judged: `rig reproduce`.

The source is R. Horváth, *Passive Pendulum Balancer for Rotor Systems*, dissertation, Auburn University, 2006.
"""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent until the program shows its log
