"""The detector over other people's truth: a labelled video in, a simulated detector's results out."""
