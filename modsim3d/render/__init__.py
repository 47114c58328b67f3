"""OpenGL, which no other room knows: its context, ID buffers, shaded pictures."""
