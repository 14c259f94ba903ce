"""Exposure steps at the seams of a surface.

They are measured (`steps`), explained by exposures of charts (`exposures`), distinguished from edges of colour
(`judgement`), and removed (`correction`, `hues`).
"""
