"""Steady motions at constant speed, resting and slipping, and the steady motion that a release reaches."""
