"""Files from outside read within bounds, files of our own written whole or not at all."""
