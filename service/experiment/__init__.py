"""An experiment: its arrays, its files, and what may be wrong with it."""
