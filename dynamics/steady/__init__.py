"""Steady motions at constant speed, resting and slipping, and which of them a release reaches."""
