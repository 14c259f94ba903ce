"""Comparison of two files."""
