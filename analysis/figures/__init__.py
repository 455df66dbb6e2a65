"""Figures as SVG text for the report and as files, in one common style."""
