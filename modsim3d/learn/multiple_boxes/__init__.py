"""Second boxes, splits and merges: how often they occur, and how long merges last."""
