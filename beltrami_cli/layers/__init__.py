"""What is coloured in a document, as samples of an image manifold, and back."""
