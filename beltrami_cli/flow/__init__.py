"""The Beltrami flow: metric, noise, parameters and the iteration."""
