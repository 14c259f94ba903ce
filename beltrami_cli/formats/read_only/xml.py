"""What the readers of XML share: a parser that malicious files cannot exhaust, and how much memory documents take."""

from __future__ import annotations

from xml.parsers import expat

MEMORY_PER_BYTE = 16  # bytes that an XML document takes while it is read, for each of its own


def safe_parser(namespace_separator: str | None = None) -> expat.XMLParserType:
    """Return a parser that raises ValueError for a document type, by which entities could expand without bounds."""
    parser = expat.ParserCreate(namespace_separator=namespace_separator)
    parser.StartDoctypeDeclHandler = _refuse
    return parser


def _refuse(*_: object) -> None:
    raise ValueError("a document type, which could make it grow without bounds, is not allowed")
