"""Equations of motion from energies with SymPy, and the comparison of the source's printed equations with them.

They verify the compiled kernel (tests/dynamics/test_derivation.py). `dynamics` itself does not import them.
Text: docs/theory/equations_of_motion.md, docs/book/misprints.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
