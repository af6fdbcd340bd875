"""The physical model of one plane: its parameters, what moves in it, and its exact derivatives."""
