"""What to measure next: options, the service's own campaign rehearsed on a twin, and what its outcome would tell."""
