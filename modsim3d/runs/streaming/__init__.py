"""Detections line by line while a scene runs, onto standard output or to readers over TCP."""
