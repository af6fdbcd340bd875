"""Where the gap lies: part, band, channel, condition, and its shape where nothing explains it."""
