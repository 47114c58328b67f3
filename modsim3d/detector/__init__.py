"""The statistical detector: state, dropout and class, box error, false positives, confidence."""
