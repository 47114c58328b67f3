"""The search for scenes in which a tracker fails."""
