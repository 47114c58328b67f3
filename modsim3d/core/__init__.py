"""Parts that every room may use: errors, types, boxes, text, random streams."""
