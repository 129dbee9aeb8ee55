"""Blind trials that share no code with the search: truth in plain MuJoCo and its callbacks."""
