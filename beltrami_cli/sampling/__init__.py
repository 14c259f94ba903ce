"""From what is coloured to samples of an image manifold, and back."""
