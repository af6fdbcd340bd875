"""The blind trial: what is withheld, sealed, measured and scored. The diagnosis imports none of it."""
