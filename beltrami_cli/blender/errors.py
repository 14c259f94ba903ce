"""The error of the extension."""


class ExchangeError(Exception):
    """The request cannot be fulfilled, for the reason in the text."""
