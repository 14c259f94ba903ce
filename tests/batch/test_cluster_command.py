"""`beltrami batch --scheduler`: the same files from many machines, whichever of them dies; encrypted if asked."""

import contextlib
import dataclasses
import shutil
import socket
import struct
import subprocess
import threading
import time
from importlib.util import find_spec

import numpy as np
import pytest

from batch.batches import QUICK, batch, copies, files_in, lines_of, smoothed, write_textured
from batch.dask_cluster import Cluster
from beltrami_cli.batch import cluster as cluster_module
from beltrami_cli.batch.chunks import ChunkRunner
from beltrami_cli.batch.cluster import OnDask
from beltrami_cli.batch.item import Item
from beltrami_cli.batch.work import do_item
from beltrami_cli.cli.main import group
from beltrami_cli.flow import cuts
from beltrami_cli.flow.chunks import Chunking, Resources
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.layers.settings import SmoothSettings
from cli.commands import COMMAND, SAMPLES, copy_samples
from flow.split_surfaces import FIXED, SURFACE, smooth_mesh

pytestmark = pytest.mark.skipif(find_spec("distributed") is None, reason="needs the extra cluster")


# A scheduler and two workers load Dask for 3 s, and each that is killed is replaced for another.
@pytest.fixture(scope="module")
def running(tmp_path_factory):
    cluster = Cluster(tmp_path_factory.mktemp("cluster"))
    yield cluster
    cluster.close()


@pytest.fixture
def cluster(running):
    running.grow(2)
    return running


@pytest.fixture
def scans(tmp_path):
    """A mesh, and a texture."""
    folder = copies("knot-noisy.ply", ["knot.ply"], tmp_path / "scans")
    copy_samples(folder / "deep", "mirrored-noisy.*")
    return folder


@pytest.mark.slow
def test_files_whole_and_in_chunks_are_as_on_one_machine_and_done_once(cluster, scans, tmp_path, monkeypatch):
    """That a batch on one machine gives what `smooth` gives has its own test."""
    batch("scans", "--out-dir", "here", *QUICK, "-n", "2", cwd=tmp_path)
    expected = files_in(tmp_path / "here")
    assert len(expected) == 4
    on_cluster = ("--scheduler", cluster.address, *QUICK, "-n", "2")
    (scans / "bad.ply").write_bytes(b"no model")
    # Paths are relative to where the command runs, which is not where the workers do.
    said = batch("scans", "--out-dir", "out", *on_cluster, cwd=tmp_path, code=1)
    assert "failed: scans/bad.ply: the content is of no known format" in said
    assert files_in(tmp_path / "out") == expected
    lines = lines_of(tmp_path / "out" / "batch.jsonl")
    assert {line["input"]: line["status"] for line in lines} == {
        "scans/bad.ply": "failed",
        "scans/deep/mirrored-noisy.obj": "done",
        "scans/knot.ply": "done",
    }
    (scans / "bad.ply").unlink()
    # What one machine did holds on the cluster.
    batch("scans", "--out-dir", "here", "--resume", *on_cluster, cwd=tmp_path)
    assert [line["status"] for line in lines_of(tmp_path / "here" / "batch.jsonl")] == ["skipped", "skipped"]

    monkeypatch.setattr(cuts, "MIN_SAMPLES", 1)
    monkeypatch.setattr(cuts, "MIN_CELLS", 1)
    batch(scans, "--out-dir", tmp_path / "joined", "--pieces", 3, *on_cluster)
    assert files_in(tmp_path / "joined") == expected


@pytest.mark.slow
def test_a_worker_that_is_killed_midway_costs_nothing_but_time(cluster, tmp_path):
    names = [f"{number}.ply" for number in range(4)]
    scans, out = copies("knot-noisy.ply", names, tmp_path / "scans"), tmp_path / "out"
    long = (*QUICK, "-n", "150")
    arguments = ["batch", scans, "--out-dir", out, "--scheduler", cluster.address, *long]
    run = subprocess.Popen([*COMMAND, *map(str, arguments)], stderr=subprocess.PIPE)
    assert cluster.kill_busy()
    said = run.communicate(timeout=120)[1].decode()
    assert run.returncode == 0, said
    assert [line["status"] for line in lines_of(out / "batch.jsonl")] == ["done"] * 4
    single = smoothed(scans / "0.ply", tmp_path / "single.ply", *long)
    assert set(files_in(out).values()) == {single}


@pytest.mark.slow
def test_a_surface_in_chunks_outlives_a_worker(cluster, monkeypatch):
    monkeypatch.setattr(cuts, "MIN_SAMPLES", 1)
    parameters = KernelParameters(**{**FIXED, "patches": "on"})
    whole = smooth_mesh(SURFACE, parameters)
    killed = []

    def progress(done, total):
        if not killed and done >= total // 4:
            cluster.kill_first()
            killed.append(done)

    with cluster.client() as client:
        cut = Resources(Chunking(3, ChunkRunner(OnDask(client, per_worker=2))))
        parts = smooth_mesh(SURFACE, parameters, progress, resources=cut)
    assert killed
    assert np.array_equal(parts.colours, whole.colours)


@pytest.mark.slow
def test_files_at_urls_are_made_with_what_lies_beside_them(tmp_path):
    """In one process, whose memory is a file system for all threads."""
    import fsspec
    from distributed import LocalCluster

    folder = copies("terrain-noisy.ply", ["a.ply"], tmp_path / "in")
    write_textured(folder)
    memory = fsspec.filesystem("memory")
    for path in folder.iterdir():
        memory.pipe_file(f"/beltrami/in/deep/{path.name}", path.read_bytes())
    memory.pipe_file("/beltrami/in/.hidden/b.ply", b"not meant")
    batch(folder, "--out-dir", tmp_path / "out", *QUICK)
    report = tmp_path / "report.jsonl"
    words = ["memory://beltrami/in", "--out-dir", "memory://beltrami/out", "--report", report, "--resume"]
    with LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=":0") as cluster:
        words = ["batch", *words, "--scheduler", cluster.scheduler_address, "-q", *QUICK]
        for status in ("done", "skipped"):
            group.main(list(map(str, words)), standalone_mode=False)
            assert [line["status"] for line in lines_of(report)] == [status] * 2
        found = {name: memory.cat_file(name) for name in memory.find("/beltrami/out")}
        expected = files_in(tmp_path / "out")
        assert found == {f"/beltrami/out/deep/{name}": data for name, data in expected.items()}

        memory.pipe_file("/beltrami/in/deep/skin.png", (SAMPLES / "mirrored-clean.png").read_bytes())
        group.main(list(map(str, words)), standalone_mode=False)
        lines = {line["input"].rsplit("/", 1)[1]: line for line in lines_of(report)}
        assert (lines["a.ply"]["status"], lines["model.obj"]["status"]) == ("skipped", "done")
        assert "memory:///beltrami/in/deep/skin.png" in lines["model.obj"]["read"]
    memory.rm("/beltrami", recursive=True)


def reset_at_once(connection):
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


# What may listen at an address that is not a scheduler.
LISTENERS = {
    "silent": b"", "drops connections": socket.socket.close, "resets connections": reset_at_once,
    "a web server": b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n", "zeros": bytes(4096),
    "ones": b"\xff" * 4096, "half a message": struct.pack("<QQQ", 100, 1, 50),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", LISTENERS)
def test_what_listens_and_is_no_scheduler_is_refused_in_one_line_and_soon(name, scans, tmp_path, monkeypatch):
    patience, answer = 1.0, LISTENERS[name]
    monkeypatch.setattr(cluster_module, "_CONNECT_TIMEOUT", patience)
    accepted = []

    def serve():
        with contextlib.suppress(OSError):
            while True:
                accepted.append(listener.accept()[0])
                with contextlib.suppress(OSError):
                    accepted[-1].sendall(answer) if isinstance(answer, bytes) else answer(accepted[-1])

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=serve, daemon=True).start()
        address = f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        start = time.monotonic()
        said = batch(scans / "knot.ply", "--out-dir", tmp_path / "out", "--scheduler", address, code=1)
        listener.shutdown(socket.SHUT_RDWR)
    assert time.monotonic() - start < 10 * patience
    assert said.count("\n") == 1
    assert f"{address}: no Dask scheduler answers there" in said
    for connection in accepted:
        connection.close()


@pytest.mark.slow
def test_nothing_is_uploaded_over_what_is_there(tmp_path):
    import fsspec

    memory = fsspec.filesystem("memory")
    memory.pipe_file("/there/in/a.ply", (SAMPLES / "terrain-noisy.ply").read_bytes())
    memory.pipe_file("/there/out/a.ply", b"mine")
    settings = SmoothSettings(KernelParameters(**FIXED))
    item = Item("memory://there/in/a.ply", "memory://there/out/a.ply", settings)
    again = dataclasses.replace(item, is_retry=True)  # after an attempt that was cut off
    for each in (item, again):
        outcome = do_item(each, None).outcome
        assert outcome.status == "failed"
        assert "memory://there/out/a.ply: exists already" in outcome.error
        assert memory.cat_file("/there/out/a.ply") == b"mine"
    memory.rm("/there/out/a.ply")
    made = do_item(item, None).outcome
    repeated = do_item(again, None).outcome
    assert (repeated.status, repeated.written) == ("done", made.written)
    memory.rm("/there", recursive=True)


@pytest.fixture
def certificates(tmp_path):
    """Dask's configuration of a certificate that signs itself, and is everybody's."""
    key, certificate = str(tmp_path / "key.pem"), str(tmp_path / "certificate.pem")
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=beltrami",
         "-keyout", key, "-out", certificate],
        check=True, capture_output=True,
    )  # fmt: skip
    files = {f"{role}.{what}": path for role in ("scheduler", "worker", "client")
             for what, path in (("key", key), ("cert", certificate))}  # fmt: skip
    return {f"distributed.comm.tls.{name}": path for name, path in {"ca-file": certificate, **files}.items()}


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificates")
def test_an_encrypted_scheduler_does_the_files(certificates, tmp_path):
    import dask
    from distributed import LocalCluster, Security

    words = (SAMPLES / "nonmanifold-noisy.ply", "--out-dir", tmp_path / "out", *QUICK, "--scheduler")
    with dask.config.set(certificates):
        options = {"protocol": "tls", "security": Security(), "processes": False, "dashboard_address": ":0"}
    with LocalCluster(n_workers=1, threads_per_worker=1, **options) as cluster:
        address = cluster.scheduler_address
        assert "TLS" in batch(*words, address, code=1)
        with dask.config.set(certificates | {"distributed.comm.require-encryption": True}):
            assert "1 done" in batch(*words, address)
            assert "encryption required" in batch(*words, address.replace("tls://", "tcp://"), code=1)
