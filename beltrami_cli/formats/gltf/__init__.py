"""glTF 2.0 and GLB: vertex colours, their places and images are replaced, everything else is kept."""
