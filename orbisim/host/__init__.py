"""What the machine offers: processors, OpenGL, a terminal, and where the engine logs."""
