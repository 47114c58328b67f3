"""What commands write: one writer at a time, and every file whole."""
