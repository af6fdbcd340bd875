"""The commissioning service: experiment, identification, diagnosis, report."""
