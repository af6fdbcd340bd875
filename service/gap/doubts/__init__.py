"""Tests for other causes of a gap than effects: the log, curved signals, swinging stiffness, the unmeasured plane."""
