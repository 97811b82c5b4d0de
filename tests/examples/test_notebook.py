"""Every cell of the example notebook runs."""

import json
import os
from pathlib import Path

import pytest
from heavy import heavy

NOTEBOOK = Path(__file__).resolve().parents[2] / "examples" / "first_steps.ipynb"
FACTS = """
import json

print(json.dumps({"pairs": len(pairs), "points": points.shape, "near_m": float(z[z > 0].min()), "losses": losses}))
"""


@pytest.mark.heavy
def test_the_notebook_runs():
    nbformat, nbclient = heavy("nbformat"), heavy("nbclient")
    for name in ("ipykernel", "torch"):
        heavy(name)
    book = nbformat.read(NOTEBOOK, as_version=4)
    book.cells.append(nbformat.v4.new_code_cell(FACTS))
    client = nbclient.NotebookClient(book, timeout=None, resources={"metadata": {"path": str(NOTEBOOK.parent)}})
    # More threads are slow while other processes run tests.
    client.execute(env={**os.environ, "OMP_NUM_THREADS": "1"})
    outputs = [output for cell in book.cells for output in cell.get("outputs", ())]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 4
    facts = json.loads(outputs[-1]["text"])
    assert facts["pairs"] == 10
    assert facts["points"] == [160, 256, 3]
    assert 0 < facts["near_m"] < 10
    losses = facts["losses"]
    assert len(losses) == 100
    assert sum(losses[-20:]) < 0.85 * sum(losses[:20])
