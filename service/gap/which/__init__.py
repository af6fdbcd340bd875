"""Which effect: the search for the explanation of a part, over single effects and mixtures."""
