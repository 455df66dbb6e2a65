"""Figures: drawn as SVG text for the report, small enough to print and alike in look."""
