"""What fitted explanations are worth: significance, closure, the verdict on one part of the loop."""
