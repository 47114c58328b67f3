"""The likeliest distribution of box errors, from edges that images and matching cut off."""
