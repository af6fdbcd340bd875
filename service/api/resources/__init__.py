"""What the API serves: rigs, jobs, experiments, models and the rest, each with its shapes and its routes."""
