"""Box errors: their distribution, unit and persistence, from the edges of matched boxes."""
