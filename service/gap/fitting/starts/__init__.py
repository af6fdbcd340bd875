"""Starting values of effects, estimated from the residuals of a twin."""
