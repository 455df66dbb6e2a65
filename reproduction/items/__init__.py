"""Functions that reproduce the items, by subject."""
