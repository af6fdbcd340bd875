"""Joint refinement: everything at once on the measured noise, how many modes, and how sure."""
