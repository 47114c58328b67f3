"""Other people's files, in and out, through labelled sets."""
