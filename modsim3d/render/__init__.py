"""OpenGL, for which there is no other room: the context, ID buffers, shaded pictures."""
