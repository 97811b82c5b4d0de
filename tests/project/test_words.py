"""Words that the glossary replaced stay out of the names of classes and functions."""

import ast
from pathlib import Path

import semisynth_gl

PACKAGE = Path(semisynth_gl.__file__).resolve().parent
OLD_CLASSES = {
    "Wanted", "Loaded", "Placed", "Placing", "Closed", "Taken", "Filled", "KeptTargets", "Cutting", "Dealing", "Drawn",
    "Population", "Stage", "StereoMix", "SharedLeft", "SubjectFinder",
}  # fmt: skip
ROOMS_THAT_SAMPLE = ("scene", "config", "pairs", "lens", "augmentation", "seeds")


def test_old_names_do_not_come_back():
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        room = path.relative_to(PACKAGE).parts[0]
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            name = getattr(node, "name", "")
            old_class = isinstance(node, ast.ClassDef) and name in OLD_CLASSES
            # Draw is a GL call, and what is painted; a random choice is sampled.
            old_function = (
                isinstance(node, ast.FunctionDef) and name.split("_")[0] == "draw" and room in ROOMS_THAT_SAMPLE
            )
            if old_class or old_function:
                found.append(f"{path.relative_to(PACKAGE)}: {name}")
    assert found == []
