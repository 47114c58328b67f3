"""Pages of HTML: text, tables and charts."""
