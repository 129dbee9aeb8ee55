"""Scenes, one in each folder, with the sources of their figures."""
