"""The Ray engine on a local cluster of two nodes."""

import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from heavy import heavy
from recorder import Recorder
from tiny_datasets import digests, tiny

from semisynth_gl.dataset.cluster import RayEngine
from semisynth_gl.dataset.generate import generate
from semisynth_gl.inputs.errors import InputError

ray = heavy("ray")
pytestmark = pytest.mark.heavy

NODE = {"num_cpus": 1, "object_store_memory": 80_000_000}
PAIRS, SEED = 12, 5


@contextmanager
def nodes():
    from ray.cluster_utils import Cluster

    both = Cluster(initialize_head=True, head_node_args=NODE | {"include_dashboard": False})
    try:
        yield both, both.add_node(**NODE)
    finally:
        both.shutdown()


def test_a_dataset_outlives_a_node_a_stop_and_an_error(tmp_path, monkeypatch):
    """One test for all three, since starting a cluster is slow."""
    monkeypatch.setenv("PYTHONPATH", ":".join(filter(None, [str(Path(__file__).parents[1]), *sys.path])))
    config = tiny(models={"complex": 0.0}, particles={"size_px": [40.0, 120.0]})

    def run(out, engine, recorder, config=config):
        options = {"layout": "webdataset", "shard_pairs": 2, "engine": engine, "listener": recorder}
        return generate(config, out, PAIRS, SEED, **options)

    run(tmp_path / "serial", None, Recorder())
    wanted = digests(tmp_path / "serial")
    with nodes() as (both, second):
        monkeypatch.setenv("RAY_ADDRESS", both.address)
        engine = RayEngine()
        with pytest.raises(KeyboardInterrupt):
            run(tmp_path / "ray", engine, Recorder(1))
        complete = len([*(tmp_path / "ray/shards").glob("semisynth-*.json")])
        assert 0 < complete < PAIRS // 2

        class Killer(Recorder):
            def on_pair(self):
                super().on_pair()
                if self.pairs == 2:
                    both.remove_node(second, allow_graceful=False)

        killer = Killer()
        run(tmp_path / "ray", engine, killer)
        assert killer.pairs <= PAIRS - 2 * complete
        assert digests(tmp_path / "ray") == wanted
        never = config.model_copy(update={"checks": config.checks.model_copy(update={"min_texture": 1e6})})
        with pytest.raises(InputError):
            run(tmp_path / "wrong", engine, Recorder(), never)


def test_a_cluster_that_is_not_there_is_told_of(monkeypatch):
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:9")
    with pytest.raises(InputError, match=r"address 127.0.0.1:9\) cannot be reached"):
        RayEngine().run(None, [], Recorder())
