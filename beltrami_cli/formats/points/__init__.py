"""Clouds of points: lines of text, NumPy archives, and the files of scanners (`survey`).

Libraries read and write the latter in a process of its own: `process`, with `scan`, `las`, `e57` and `pcd`.
"""
