"""One explanation of one part of the loop, fitted: what is uncertain, the prediction, the fit, its evidence."""
