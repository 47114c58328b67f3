"""Pose sources: which vessels are present at each step, where they are, and their headings."""
