"""Frozen array records: what is passed between the rooms of the house, and its validation."""
