"""Headless rendering: the OpenGL context, ID buffers, shaded pictures. Nothing here is imported by modsim3d itself."""
