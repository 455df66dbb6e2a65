"""Functions that make the items, by subject."""
