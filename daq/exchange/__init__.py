"""Exchange with other programs' files: `export_log`, `import_recording`."""

from daq.exchange.errors import ExchangeError
from daq.exchange.export import Exported, export_log
from daq.exchange.import_recording import Imported, import_recording
from daq.exchange.recipe import Recipe, make_recipe

__all__ = [
    "ExchangeError",
    "Exported",
    "Imported",
    "Recipe",
    "export_log",
    "import_recording",
    "make_recipe",
]
