"""Rig time that a health check may take."""

SMALLEST_S, USUAL_S, LARGEST_S = 20.0, 90.0, 3600.0
"""A tenth of a commissioning's is plenty; what takes an hour is none."""
