"""Labelled sets from the files that other programs write."""
