"""The API under /api/v1: HTTP in, jobs and documents out."""
