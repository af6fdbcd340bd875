"""The rig in software: pure physics, no input or output."""
