"""The page of a run: a player of its frames in one file of HTML, without network or server."""
