"""Exposure steps at the seams of a surface: found, distinguished from paint, and removed."""
