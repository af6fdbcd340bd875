"""What still rang while a point was recorded: how large it was, taken out of the blocks."""
