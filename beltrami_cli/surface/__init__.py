"""Records and geometry of surfaces, which all other packages share."""
