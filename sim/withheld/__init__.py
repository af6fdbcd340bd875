"""What is withheld, and the seal on it: of one kind for the blind trial and for a rig that is served on a bus.

The diagnosis imports none of it, and nothing else of `sim` does.
"""

CAMPAIGN_S = 300.0
"""Rig time that a compact campaign over four axes takes, about."""
