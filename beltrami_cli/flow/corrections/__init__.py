"""Corrections of what averages alone do not handle: outliers, clipping, shared or JPEG-coded noise, mean radiance."""
