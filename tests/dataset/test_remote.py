"""Datasets in an object store, tested with a local S3 server."""

import subprocess
import sys
import time

import pytest
from processes import run_python
from tiny_datasets import PAIRS, SEED, command, digests, findings, tiny

from semisynth_gl.dataset.generate import generate
from semisynth_gl.dataset.root import names_below, open_root, read_whole
from semisynth_gl.inputs.errors import InputError, ReadError

BUCKET = "s3://datasets"


@pytest.fixture
def store(monkeypatch):
    """Yield the address of an empty bucket."""
    pytest.importorskip("s3fs")
    server = pytest.importorskip("moto.server").ThreadedMotoServer(port=0)
    server.start()
    host, port = server.get_host_and_port()
    for name, value in (
        ("AWS_ENDPOINT_URL", f"http://{host}:{port}"),
        ("AWS_ACCESS_KEY_ID", "nobody"),
        ("AWS_SECRET_ACCESS_KEY", "nothing"),
        ("AWS_DEFAULT_REGION", "us-east-1"),
    ):
        monkeypatch.setenv(name, value)
    import s3fs

    # Each server has another port, and s3fs caches the connection.
    s3fs.S3FileSystem.clear_instance_cache()
    system = s3fs.S3FileSystem()
    if not system.exists("datasets"):  # servers in one process share their buckets
        system.mkdir("datasets")
    yield BUCKET
    server.stop()


def fetched(address, to):
    root = open_root(address)
    for name in names_below(root):
        (to / name).parent.mkdir(parents=True, exist_ok=True)
        (to / name).write_bytes((root / name).read_bytes())
    return digests(to)


def test_a_killed_run_leaves_whole_shards_and_is_taken_up(store, tmp_path):
    config = tiny(models={"complex": 0.0}, particles={"size_px": [40.0, 120.0]})
    generate(config, tmp_path / "here", PAIRS, SEED, layout="webdataset", shard_pairs=3)
    wanted = digests(tmp_path / "here")
    run = command(config, tmp_path / "x", "webdataset")
    run[run.index("--out") + 1] = f"{store}/set"
    process = subprocess.Popen(run, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    root = open_root(f"{store}/set")
    try:
        while not any(name.endswith(".tar") for name in names_below(root)):
            assert process.poll() is None
            # Polling without pause would slow down the server, which is a thread of this process.
            time.sleep(0.05)
    finally:
        process.kill()
        process.wait()
    for name in names_below(root):
        if name.endswith(".tar"):
            assert (root / name).read_bytes() == (tmp_path / "here" / name).read_bytes()
    assert run_python(*run[1:])[:2] == (0, f"{PAIRS} pairs in {store}/set\n")
    assert fetched(f"{store}/set", tmp_path / "there") == wanted
    assert findings(f"{store}/set") == []


def test_what_the_store_refuses_is_told(store, monkeypatch):
    config = tiny(models={"complex": 0.0}, particles={"size_px": [40.0, 120.0]})
    with pytest.raises(InputError, match=r"no-such-bucket.*; check address, rights"):
        generate(config, "s3://no-such-bucket/x", 1, SEED)
    with pytest.raises(ReadError, match="is missing"):
        read_whole(open_root(store), "none")
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    for name in ("AWS_SHARED_CREDENTIALS_FILE", "AWS_CONFIG_FILE"):
        monkeypatch.setenv(name, "/nowhere")
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    with pytest.raises(InputError, match=r"(?i)credentials"):
        generate(config, f"{store}/x", 1, SEED)


def test_a_protocol_without_its_package_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "gcsfs", None)
    with pytest.raises(InputError, match=r"pip install 'semisynth-gl\[remote\]'"):
        open_root("gs://bucket/x")
