"""The noise of colours, estimated from the colours themselves."""
