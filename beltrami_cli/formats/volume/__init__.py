"""Volumes: level sets sampled on a grid, and colours for them, from NumPy archives and NRRD files."""

from __future__ import annotations

from beltrami_cli.formats.volume.reading import is_volume, read_colours, read_volume

__all__ = ["is_volume", "read_colours", "read_volume"]
