"""Smooth one file: read, sample, iterate, write, and tell what was done."""
