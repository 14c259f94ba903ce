"""Images, flat or on a surface: from files and arrays to the flow and back."""
