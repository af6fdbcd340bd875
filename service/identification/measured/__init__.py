"""From an experiment to the points that are fitted: which sweeps, how noisy, and their frequency responses."""
