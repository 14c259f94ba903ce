"""Exposure steps at the seams of a surface: found, distinguished from edges of colour, and removed."""
