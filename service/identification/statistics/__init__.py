"""Algebra and statistics that know nothing of a rotor."""
