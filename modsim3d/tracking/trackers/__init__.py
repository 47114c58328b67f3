"""Trackers: a reference of our own, adapters to libraries, plug-ins."""
