"""A campaign by multisines: lines, amplitudes and phases for all axes at once."""
