"""The Beltrami flow: embedding, units, noise, colour spaces and the iteration."""
