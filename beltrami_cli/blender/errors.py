"""The error of the extension."""


class ExtensionError(Exception):
    """The request cannot be fulfilled, for the reason in the text."""
