"""Scenes: the keys of a scene file, reading and checking it, what is where at a step."""
