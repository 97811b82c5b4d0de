"""Where others run it: the container, the workflow of hosted runners, and the version that a release carries."""

import json
import re
import tomllib
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from semisynth_gl.render.context import INSTALL_COMMAND

CHECKOUT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text("utf-8"))


# The container


@pytest.fixture(scope="module")
def stages():
    """The instructions of each stage of the Containerfile, in order: (name, arguments)."""
    text = re.sub(r"^#.*\n", "", (CHECKOUT / "Containerfile").read_text("utf-8"), flags=re.MULTILINE)
    lines = [line for line in text.replace("\\\n", " ").splitlines() if line.strip()]
    instructions = [tuple(line.split(None, 1)) for line in lines]
    starts = [number for number, (name, _) in enumerate(instructions) if name == "FROM"]
    return [instructions[start:end] for start, end in zip(starts, [*starts[1:], None], strict=True)]


def arguments(stage, name):
    return [text for instruction, text in stage if instruction == name]


def packages(stage):
    [names] = [found[1] for text in arguments(stage, "RUN") if (found := re.search(r"recommends +([^&]*)", text))]
    return set(names.split())


def test_the_container_installs_the_packages_of_a_bare_machine(stages):
    script = (CHECKOUT / "tools" / "system-packages.sh").read_text("utf-8")
    wanted = set(" ".join(re.findall(r'^(?:opengl|osmesa)_packages?="(.*)"$', script, re.MULTILINE)).split())
    assert wanted > set(INSTALL_COMMAND.split()[3:])
    wheel, program = stages
    assert packages(program) == {"python3", *wanted}
    assert packages(wheel) == {"ca-certificates", "python3", "python3-venv"}
    # The environment is copied from one stage to the other, so that both need one Python.
    bases = {arguments(stage, "FROM")[0].split()[0] for stage in stages}
    assert len(bases) == 1
    assert re.fullmatch(r"docker\.io/library/debian:\w+-slim", bases.pop())


def test_the_container_copies_what_a_wheel_takes(stages):
    copied = {name for text in arguments(stages[0], "COPY") for name in text.split()[:-1]}
    wheel = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"]
    project = PROJECT["project"]
    assert copied == {*wheel, "pyproject.toml", project["readme"], *project["license-files"]}
    assert all((CHECKOUT / name).exists() for name in copied)


def test_the_container_is_ready_for_a_gpu(stages):
    program = stages[1]
    variables = dict(word.split("=", 1) for text in arguments(program, "ENV") for word in text.split())
    assert variables["NVIDIA_VISIBLE_DEVICES"] == "all"
    assert set(variables["NVIDIA_DRIVER_CAPABILITIES"].split(",")) == {"graphics", "compute", "utility"}
    [vendor] = [text for text in arguments(program, "RUN") if "/usr/share/glvnd/egl_vendor.d/10_nvidia.json" in text]
    assert json.loads(re.search(r"'(\{.*\})'", vendor)[1])["ICD"] == {"library_path": "libEGL_nvidia.so.0"}


def test_the_container_runs_the_program_as_no_root(stages):
    program = stages[1]
    [user] = arguments(program, "USER")
    assert re.search(rf"useradd .*{user}\b", " ".join(arguments(program, "RUN")))
    assert arguments(program, "ENTRYPOINT") == [json.dumps(list(PROJECT["project"]["scripts"]))]
    assert arguments(program, "WORKDIR") == ["/data"]


# The workflow


@pytest.fixture(scope="module")
def workflow():
    return YAML(typ="safe", pure=True).load(CHECKOUT / ".github" / "workflows" / "ci.yml")


def test_the_workflow_runs_the_tests_and_checks_the_package(workflow):
    assert {"push", "pull_request"} == set(workflow["on"])
    steps = {name: [step.get("run") for step in job["steps"]] for name, job in workflow["jobs"].items()}
    assert steps["tests"][-1] == ".ci/run"
    assert (CHECKOUT / ".ci" / "run").stat().st_mode & 0o111
    assert steps["package"][-1] == "make release-check"
    assert re.search(r"^release-check:", (CHECKOUT / "Makefile").read_text("utf-8"), re.MULTILINE)
    # A mistake in the workflow may write nothing.
    assert workflow["permissions"] == {"contents": "read"}


def test_actions_are_pinned_to_a_commit(workflow):
    used = [step["uses"] for job in workflow["jobs"].values() for step in job["steps"] if "uses" in step]
    assert len(used) >= 3
    for action in used:
        assert re.fullmatch(r"actions/[\w-]+@[0-9a-f]{40}", action), action


def test_the_workflow_tests_systems_that_were_tried(workflow):
    images = workflow["jobs"]["tests"]["strategy"]["matrix"]["image"]
    tried = re.findall(r"^\| Debian \d+ \((\w+)\)", (CHECKOUT / "docs" / "install.md").read_text("utf-8"), re.MULTILINE)
    assert images == [f"debian:{name}" for name in tried]


# The version


def test_the_version_is_the_same_everywhere():
    citation = YAML(typ="safe", pure=True).load(CHECKOUT / "CITATION.cff")
    newest = re.search(r"^## (\S+), ", (CHECKOUT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert str(citation["version"]) == newest[1] == PROJECT["project"]["version"]


def test_the_release_page_names_each_place_of_the_version():
    page = (CHECKOUT / "docs" / "releasing.md").read_text("utf-8")
    for name in ("pyproject.toml", "CITATION.cff", "CHANGELOG.md"):
        assert f"`{name}`" in page, name
    for target in re.findall(r"\bmake ([\w-]+)", page):
        assert re.search(rf"^{target}:", (CHECKOUT / "Makefile").read_text("utf-8"), re.MULTILINE), target
