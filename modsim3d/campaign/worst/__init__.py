"""The runs that went worst: which they are, each made again, and a picture of the moment at which it went wrong."""
