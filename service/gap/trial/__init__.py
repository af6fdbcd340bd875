"""The blind trial: effects are withheld, sealed, measured, diagnosed and scored. The diagnosis imports none of it."""
