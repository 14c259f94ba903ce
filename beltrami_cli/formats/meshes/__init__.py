"""Meshes between formats: scenes with materials, coloured polygons, and what writers take of both."""
