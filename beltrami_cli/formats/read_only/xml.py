"""What the readers of XML share: a parser that malicious files cannot exhaust, and how much memory documents take."""

from __future__ import annotations

from xml.parsers import expat

TREE_SIZE = 16  # times as much memory as its text takes an XML document while it is read


def safe_parser(namespace_separator: str | None = None) -> expat.XMLParserType:
    """Return a parser that raises ValueError for a document type, by which entities could expand without bounds."""
    parser = expat.ParserCreate(namespace_separator=namespace_separator)
    parser.StartDoctypeDeclHandler = _refuse
    return parser


def _refuse(*_: object) -> None:
    raise ValueError("a document type, which could make it grow without bounds, is not allowed")
