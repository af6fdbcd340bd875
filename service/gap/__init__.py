"""Where the twin and the rig differ, which effect explains it, and how far; pure."""
