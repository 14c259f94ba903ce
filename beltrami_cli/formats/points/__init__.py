"""Clouds of points: lines of text (.xyz, .pts) and NumPy archives (.npz), which keep their bytes."""

from beltrami_cli.formats.points.archive import NpzPointsDocument
from beltrami_cli.formats.points.text_document import TextPointsDocument
from beltrami_cli.formats.points.writer import write_npz, write_pts, write_xyz

__all__ = ["NpzPointsDocument", "TextPointsDocument", "write_npz", "write_pts", "write_xyz"]
