"""Trackers, our own and adapters to others, and their scores in the images and in metres."""
