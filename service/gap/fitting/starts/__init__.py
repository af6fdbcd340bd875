"""Starting values of effects, found in what the twin leaves unexplained."""
