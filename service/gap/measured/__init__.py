"""Sweeps prepared for fitting: `Observation`s of mean amplitudes and the standard deviations of their residuals."""
