"""Judgement of fitted explanations: ranking, significance, closure, and the verdict on one part of the loop."""
