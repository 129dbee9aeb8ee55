"""What keeps reading bounded: time, memory, folders, and files that mean what they seem to."""
