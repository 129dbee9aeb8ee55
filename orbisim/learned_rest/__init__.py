"""A learned force for what no effect explains. It is no effect."""
