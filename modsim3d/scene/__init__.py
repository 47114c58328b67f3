"""A scene: the keys of its file, reading and checking it, and what is where at a step."""
