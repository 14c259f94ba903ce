"""Clouds of points: lines of text, NumPy archives, and the files of scanners, which keep their bytes."""
