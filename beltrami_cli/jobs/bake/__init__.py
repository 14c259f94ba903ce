"""Move colours between textures and vertices."""
