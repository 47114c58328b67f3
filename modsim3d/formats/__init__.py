"""Other programs' files, in and out, through one labelled set."""
