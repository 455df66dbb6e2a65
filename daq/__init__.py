"""Acquisition: devices, their protocols, logs, guided tests, replay, the catalogue, the virtual rig.

Public here: an open rig, recordings, logs and their signals. `daq.exchange` reads and writes files of other programs,
`daq.replay` decodes raw bytes again, `daq.lockstep.Rehearsal` records guided tests on the virtual rig.
"""

import logging

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent until the program shows its log
