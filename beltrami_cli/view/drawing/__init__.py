"""Views of surfaces, points and images, and their arrangement in one picture."""
