"""Pictures of painted surfaces, points and images, drawn by the processor alone."""
