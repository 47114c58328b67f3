"""The detector over other people's labelled videos."""
