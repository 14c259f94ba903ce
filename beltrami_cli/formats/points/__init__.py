"""Clouds of points: lines of text (.xyz, .pts) and NumPy archives (.npz), which keep their bytes."""
