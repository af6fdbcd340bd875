"""What to measure next: options, campaigns rehearsed on a twin, and how well their data would separate rivals."""
