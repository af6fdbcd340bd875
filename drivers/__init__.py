"""How to talk to a controller of a magnetic-bearing rig."""
