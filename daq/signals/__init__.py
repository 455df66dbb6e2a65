"""Signals of a log on one clock, and the decision whether they have settled."""
