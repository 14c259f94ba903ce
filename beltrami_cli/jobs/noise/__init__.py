"""Adding noise to the colours of a file: `file` does, `kinds` computes noise, `samples` takes it to layers and back."""
