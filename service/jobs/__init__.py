"""Jobs that survive: durable workflows on a queue for rigs and a queue for calculations."""
