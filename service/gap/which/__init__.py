"""Which effect: every explanation of a part tried, alone and together, and held against unseen data."""
