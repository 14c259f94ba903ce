"""What image files hold besides pixels, a module for each format: chunks, segments, tags and headers."""
