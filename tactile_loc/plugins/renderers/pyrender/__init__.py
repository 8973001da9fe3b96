"""The renderer that draws with OpenGL through pyrender."""
