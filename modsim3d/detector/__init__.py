"""The statistical detector, which knows boxes and their attributes, nothing of cameras or OpenGL."""
