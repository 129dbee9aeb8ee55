"""Closing the loop on measured data: what to run, how to score, what to show."""
