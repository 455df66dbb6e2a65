"""Studies in many parts: maps, hundreds of campaigns, archives of logs; on one machine or on many.

A `Study` is a question with a number of tiles. A `TileFolder` contains one finished file per tile. An engine computes
tiles, in this process, in processes of its own or on dask's workers. `run_study` joins the three: tiles in the folder
are not computed again, so that the same command continues after an interruption.
"""

import logging

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent until the program shows its log
