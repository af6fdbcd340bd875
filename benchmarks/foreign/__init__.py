"""Rigs of another program: physics, effects and file format written without the project's own packages."""
