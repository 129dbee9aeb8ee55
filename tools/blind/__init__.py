"""Blind trials of the diagnosis: recordings with hidden effects, and the score of what is found."""
