"""The silhouettes of a recording: closed lines, in the order in which the page paints them."""
