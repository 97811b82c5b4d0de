"""The figures of tests/test_hard_cases.py as a table: what each case that is compared with the oracle comes to.

python benchmarks/hard_cases.py > hard_cases.md
"""

import re
import sys
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest

TESTS = Path(__file__).resolve().parents[1] / "tests"


def main() -> None:
    """Run the tests on one backend and print a row per case: both eyes, all pixels that were compared."""
    with redirect_stdout(sys.stderr):
        code = pytest.main(["-q", "-k", "egl", str(TESTS / "test_hard_cases.py")])
    if code:
        sys.exit(int(code))
    cases: dict[str, list] = {}
    for test, found in sys.modules["test_hard_cases"].FIGURES:
        name = re.sub(r".*::test_(\w+)\[egl-?(.*)\].*", r"\1 \2", test).replace("_", " ").strip()
        cases.setdefault(name, []).append(found)
    print("| case | pixels | median | 99.9 % | worst | elsewhere | visibility |")
    print("|---|---|---|---|---|---|---|")
    for name, parts in cases.items():
        error = np.concatenate([found.error[found.smooth & ~found.displaced] for found in parts])
        displaced = np.mean(np.concatenate([found.displaced for found in parts]))
        alike = np.mean(np.concatenate([found.seen_alike for found in parts]))
        print(
            f"| {name} | {len(error)} | {np.median(error):.1e} | {np.quantile(error, 0.999):.1e} | {error.max():.1e} "
            f"| {100 * displaced:.3f} % | {100 * alike:.2f} % |"
        )


if __name__ == "__main__":
    main()
