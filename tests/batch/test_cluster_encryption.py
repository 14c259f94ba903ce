"""`--scheduler tls://...`: encrypted with the certificates of Dask's configuration, or refused in a line."""

from __future__ import annotations

import shutil
import subprocess
import time

import pytest

from batch.batches import QUICK
from batch.dask_cluster import Cluster
from cli.commands import COMMAND, SAMPLES

pytest.importorskip("distributed")
pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificates")

TLS = "DASK_DISTRIBUTED__COMM__TLS__"


@pytest.fixture
def certificates(tmp_path):
    """Variables for a certificate that signs itself, and is everybody's."""
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=beltrami",
         "-keyout", key, "-out", certificate],
        check=True, capture_output=True,
    )  # fmt: skip
    roles = {f"{TLS}{role}__{what}": str(path) for role in ("SCHEDULER", "WORKER", "CLIENT")
             for what, path in (("KEY", key), ("CERT", certificate))}  # fmt: skip
    return {f"{TLS}CA_FILE": str(certificate), **roles}


@pytest.mark.slow
def test_an_encrypted_scheduler_does_the_files(certificates, tmp_path, monkeypatch):
    for name, value in certificates.items():
        monkeypatch.setenv(name, value)
    (tmp_path / "cluster").mkdir()
    cluster = Cluster(tmp_path / "cluster", "--protocol", "tls")
    shutil.copy(SAMPLES / "nonmanifold-noisy.ply", tmp_path / "a.ply")
    arguments = ("--out-dir", tmp_path / "out", "--overwrite", "--scheduler", cluster.address, *QUICK)

    def said(code):
        # Dask reads the variables as it is loaded, so each run is a process of its own.
        run = subprocess.run(
            [*COMMAND, "batch", tmp_path / "a.ply", *arguments], check=False, capture_output=True, text=True
        )
        assert run.returncode == code, run.stderr
        assert "Traceback" not in run.stderr
        return run.stderr

    try:
        deadline = time.monotonic() + 60
        while not cluster.address.exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        assert '"tls://' in cluster.address.read_text()
        refused_without(certificates, monkeypatch, said)
        cluster.start_worker()
        assert "1 done" in said(0)
        cluster.address.write_text(cluster.address.read_text().replace("tls://", "tcp://"))
        monkeypatch.setenv("DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION", "true")
        assert "encryption is required" in said(1)
    finally:
        cluster.close()


def refused_without(certificates, monkeypatch, said):
    with monkeypatch.context() as without:
        for name in certificates:
            without.delenv(name)
        assert "TLS" in said(1)
