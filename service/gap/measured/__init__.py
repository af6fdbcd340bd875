"""What was measured, made ready to be weighed: sweeps as observations, with the noise that a model must leave."""
