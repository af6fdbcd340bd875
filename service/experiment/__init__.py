"""The automated experiment: which tones, how large, how long, and its file."""
