"""Files that recordings are read from: a reader for each format, found by entry point."""
