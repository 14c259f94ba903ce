"""The live view: a page on which a document is smoothed while parameters are changed, and its server."""
