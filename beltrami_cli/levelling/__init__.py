"""Exposure steps at the seams of a surface: detection, distinction from edges of colour, and removal."""
