"""Smoothing arrays: arrays in, arrays out."""
