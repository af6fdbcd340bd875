"""Rig time that a health check may take."""

SMALLEST_S, USUAL_S, LARGEST_S = 20.0, 90.0, 3600.0
"""A tenth of a commissioning's is plenty; what takes an hour is none."""
RECENT_S = 2 * LARGEST_S
"""A check goes on with points of its own that are no older: the longest one's, with an outage in between. It tells how
the rig is when it ends, which older points do not know."""
