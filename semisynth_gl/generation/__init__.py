"""Generation of datasets: an engine makes their shards as tasks."""
