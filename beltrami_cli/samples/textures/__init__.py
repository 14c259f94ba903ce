"""Textures: from the pictures of a model to the flow and back."""
