"""Learned dynamics of cloth: a flex of free vertices that falls over what stands still."""
