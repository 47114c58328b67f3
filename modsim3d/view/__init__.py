"""What people look at: pictures, films, maps and pages."""
