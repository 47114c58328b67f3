"""The recording of a run that its page plays: columns of numbers, in parts, in few bytes."""
