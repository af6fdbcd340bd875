"""What is known of a plane besides its data: the datasheet's values, and the shapes of modes that data cannot tell."""
