"""Fit of one explanation to one part of the loop: unknowns, prediction, objective, fit, evidence."""
