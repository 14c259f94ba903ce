"""Files of any kind: what may be read of them, and their archives, arrays and text, whose bytes can be replaced."""
