"""Logs: writing (`file`), reading (`opened`), recovery (`recover`), and the facts they contain.

The reader is imported at its first use: it takes a third of a second to load, and a program that writes logs does not
need it.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
