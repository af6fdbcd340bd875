"""From frequency responses to a physical model with its uncertainty; pure."""
