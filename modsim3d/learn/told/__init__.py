"""What was learned, as tables and as a page."""
