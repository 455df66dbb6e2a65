"""All logs of a folder, with their facts, and a search over them."""

from daq.catalogue.entry import Entry
from daq.catalogue.query import Query, parse_instant
from daq.catalogue.search import Catalogue

__all__ = ["Catalogue", "Entry", "Query", "parse_instant"]
