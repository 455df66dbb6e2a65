"""A log as signals on one clock, and when they have settled."""
