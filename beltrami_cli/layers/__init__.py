"""The coloured parts of a document as samples of an image manifold, and the way back."""
