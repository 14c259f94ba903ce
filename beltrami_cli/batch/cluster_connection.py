"""The connection to a Dask scheduler."""

from __future__ import annotations

import contextlib
import logging
import socket
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from beltrami_cli.errors import ProcessingError
from beltrami_cli.formats.data_text import CONFIGURATION, parse_json, read_bounded

if TYPE_CHECKING:
    from collections.abc import Iterator

LOST = "the connection to the scheduler was lost"

_PATIENCE = 15.0  # seconds for a scheduler to answer


@contextlib.contextmanager
def connected(address: str) -> Iterator[Any]:
    """Give a distributed.Client of a scheduler: at tcp://HOST:PORT, or where a file (.json) that it wrote says."""
    try:
        from distributed import Client
        from distributed.security import Security
    except ImportError as error:
        raise ProcessingError(
            "--scheduler needs Dask, which is not installed; pip install 'beltrami-cli[cluster]'"
        ) from error
    # What goes wrong is reported by us, in one line.
    for name in ("distributed", "distributed.client", "distributed.comm"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        where = _address_in(address) if address.endswith(".json") else address
        _require_listener(where)
        security = Security()  # certificates, and whether they are required, from Dask's own configuration
        _require_encryption(where, security)
        client = Client(where, timeout=_PATIENCE, set_as_default=False, security=security)
    except (OSError, ValueError, KeyError, TypeError) as error:
        cause = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise ProcessingError(
            f"{address}: no Dask scheduler answers there ({cause}); start one with dask scheduler, or check the address"
        ) from error
    try:
        yield client
    finally:
        client.close()


def _address_in(path: str) -> str:
    """Return what a scheduler wrote into a file."""
    return str(parse_json(read_bounded(Path(path), CONFIGURATION))["address"])


def _require_encryption(address: str, security: Any) -> None:
    """Raise ValueError if encryption is asked for without certificates, or required and not asked for."""
    is_encrypted = address.startswith("tls://")
    if is_encrypted and security.get_connection_args("client").get("ssl_context") is None:
        raise ValueError(
            "TLS needs distributed.comm.tls in Dask's configuration: ca-file, client.cert and client.key"
        )
    if security.require_encryption and not is_encrypted:
        raise ValueError("encryption is required by Dask's configuration, and the address is not tls://")


def _require_listener(address: str) -> None:
    """Raise ValueError or OSError if nobody listens at an address, where a client would try for long."""
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    if parts.scheme == "inproc" and parts.path.count("/") == 2:  # one of this process
        return
    if not parts.hostname or not parts.port:
        raise ValueError("an address is like tcp://HOST:PORT")
    socket.create_connection((parts.hostname, parts.port), timeout=_PATIENCE).close()
