"""Noise laid on a surface."""
