"""The rotor that turns: both planes together at several speeds, its whirl and its Campbell diagram."""
