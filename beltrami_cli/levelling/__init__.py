"""Exposure steps at the seams of a surface: found, told from paint, and taken out."""
