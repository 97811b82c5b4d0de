"""How a machine is set up and tested: scripts of tools/ on made-up machines, the Makefile, and what the tests need."""

import os
import re
import shutil
import subprocess
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest
from heavy import heavy
from hypothesis import given, settings
from hypothesis import strategies as st

from semisynth_gl.render.context import INSTALL_COMMAND, INSTALL_COMMAND_OSMESA
from semisynth_gl.render.devices import LIBRARIES

CHECKOUT = Path(__file__).resolve().parents[2]
PACKAGED = ("middlebury", "kitti", "eth3d", "sceneflow", "zero-shot", "active-infrared")
SCRIPT = CHECKOUT / "tools" / "system-packages.sh"
ALL_PACKAGES = "libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri libosmesa6"

# Answers the script's questions: its version, whether venv is there, whether the backend named last works.
PYTHON = """\
case "$*" in
    *version_info\\ \\<*) [ -e "$HERE/recent" ] ;;
    --version) echo "Python 3.9.2" ;;
    *ensurepip*) [ -e "$HERE/venv" ] ;;
    *python%d*) echo python3.11-venv ;;
    -P*) cat >/dev/null; for backend; do :; done; [ -e "$HERE/$backend" ] ;;
esac
"""
# Installing brings what the packages bring; the arguments are kept to be looked at.
APT_GET = """\
echo "$*" >>"$HERE/apt-get.log"
[ "$1" != install ] || [ -e "$HERE/useless" ] || touch "$HERE/egl" "$HERE/auto" "$HERE/venv"
case "$*" in *libosmesa6*) touch "$HERE/osmesa" ;; esac
"""
APT_CACHE = '[ "$2" != libosmesa6 ] || [ -e "$HERE/osmesa-offered" ]\n'


@dataclass
class Machine:
    """A folder of stand-ins, which is all that PATH names, and marks of what the machine has."""

    folder: Path

    def has(self, *marks: str) -> None:
        for mark in marks:
            (self.folder / mark).touch()

    def offers(self, name: str, program: str) -> None:
        path = self.folder / "bin" / name
        path.write_text(f"#!/bin/sh\n{program}")
        path.chmod(0o755)

    def run(self, *backends: str) -> tuple[int, str]:
        """Run the script; return its exit code and what it said."""
        done = subprocess.run(
            ["/bin/sh", str(SCRIPT), "python3", *backends],
            env={"PATH": str(self.folder / "bin"), "HERE": str(self.folder)},
            capture_output=True,
            text=True,
            check=False,
        )
        return done.returncode, done.stderr

    def installed(self) -> str:
        """What apt-get was asked to do."""
        log = self.folder / "apt-get.log"
        return log.read_text() if log.exists() else ""


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    """Debian with a recent Python, a user of no privileges, and no OpenGL."""
    made = Machine(tmp_path)
    (tmp_path / "bin").mkdir()
    for tool in ("cat", "env", "sh", "touch", "true"):
        (tmp_path / "bin" / tool).symlink_to(shutil.which(tool) or tool)
    made.offers("python3", PYTHON)
    made.offers("apt-get", APT_GET)
    made.offers("apt-cache", APT_CACHE)
    made.offers("id", "echo 1000\n")
    made.has("recent", "venv", "osmesa-offered")
    return made


def become_root(machine: Machine) -> None:
    machine.offers("id", "echo 0\n")


def test_nothing_is_done_where_all_is_well(machine: Machine) -> None:
    machine.has("auto")
    assert machine.run("auto") == (0, "")
    assert machine.installed() == ""


def test_an_old_python_is_refused_in_one_line(machine: Machine) -> None:
    (machine.folder / "recent").unlink()
    code, said = machine.run("auto")
    assert code == 1
    assert said.startswith("Python 3.11 or newer is needed, but python3 is: Python 3.9.2.")
    assert said.count("\n") == 1


def test_a_user_who_may_not_install_gets_the_one_line_to_type(machine: Machine) -> None:
    line = f"apt-get update && apt-get install -y {ALL_PACKAGES}"
    assert machine.run("auto") == (1, f"Missing: OpenGL. Type this, as root: {line}\n")
    assert machine.installed() == ""


def test_a_user_whose_sudo_asks_for_a_password_gets_the_line_with_sudo(machine: Machine) -> None:
    machine.offers("sudo", "exit 1\n")
    line = f"sudo apt-get update && sudo apt-get install -y {ALL_PACKAGES}"
    assert machine.run("auto") == (1, f"Missing: OpenGL. Type this: {line}\n")


def test_the_line_brings_venv_and_opengl_together(machine: Machine) -> None:
    (machine.folder / "venv").unlink()
    code, said = machine.run("auto")
    assert code == 1
    assert said.startswith("Missing: Python's venv module and OpenGL. ")
    assert said.endswith(f"apt-get install -y python3.11-venv {ALL_PACKAGES}\n")


def test_venv_alone_is_asked_for_alone(machine: Machine) -> None:
    (machine.folder / "venv").unlink()
    code, said = machine.run()
    assert code == 1
    assert said.endswith("apt-get install -y python3.11-venv\n")


def test_root_installs(machine: Machine) -> None:
    become_root(machine)
    code, _ = machine.run("egl", "osmesa")
    assert code == 0
    update, install = machine.installed().splitlines()
    assert update.startswith("update")
    assert install.endswith(ALL_PACKAGES)


def test_a_sudo_that_asks_nothing_installs(machine: Machine) -> None:
    machine.offers("sudo", '[ "$1" != -n ] || shift\nexec "$@"\n')
    assert machine.run("auto")[0] == 0
    assert ALL_PACKAGES in machine.installed()


def test_where_apt_has_no_osmesa_the_rest_is_installed(machine: Machine) -> None:
    become_root(machine)
    (machine.folder / "osmesa-offered").unlink()
    assert machine.run("egl", "osmesa")[0] == 0
    assert machine.installed().splitlines()[1].endswith(ALL_PACKAGES.removesuffix(" libosmesa6"))


def test_an_osmesa_that_cannot_be_had_is_said_and_not_asked_for_again(machine: Machine) -> None:
    become_root(machine)
    (machine.folder / "osmesa-offered").unlink()
    machine.has("egl")
    code, said = machine.run("egl", "osmesa")
    assert code == 0
    assert said == "OSMesa is missing, and this system offers no package of it; going on with egl.\n"
    assert machine.installed() == ""


def test_one_backend_of_two_is_enough_for_a_user_who_may_not_install(machine: Machine) -> None:
    machine.has("egl")
    code, said = machine.run("egl", "osmesa")
    assert code == 0
    assert said.startswith("Missing: OpenGL (osmesa). Going on with egl. ")


def test_packages_that_do_not_help_are_an_error(machine: Machine) -> None:
    become_root(machine)
    machine.has("useless")
    code, said = machine.run("egl")
    assert code == 1
    assert "no OpenGL context opens (egl)" in said


def test_without_apt_the_libraries_are_named(machine: Machine) -> None:
    (machine.folder / "bin" / "apt-get").unlink()
    code, said = machine.run("auto")
    assert code == 1
    assert "libEGL.so.1, libGL.so.1" in said


def test_the_packages_are_those_of_the_messages() -> None:
    variables = dict(re.findall(r'^(opengl_packages|osmesa_package)="(.*)"$', SCRIPT.read_text("utf-8"), re.MULTILINE))
    opengl, osmesa = variables["opengl_packages"].split(), variables["osmesa_package"].split()
    assert INSTALL_COMMAND.removeprefix("apt-get install -y ").split() == opengl
    assert INSTALL_COMMAND_OSMESA.split()[3] in osmesa
    assert set(INSTALL_COMMAND_OSMESA.split()[3:]) <= {*opengl, *osmesa}
    assert set(LIBRARIES.values()) <= {*opengl, *osmesa}


def make(*arguments: str) -> str:
    # The variables of a make that runs these tests are none of this one's.
    environment = {"PATH": os.environ["PATH"]}
    command = ["make", "--no-print-directory", *arguments]
    done = subprocess.run(command, cwd=CHECKOUT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_make_lists_its_targets() -> None:
    listed = make()
    datasets = ("middlebury kitti eth3d sceneflow zero-shot active-infrared", "ablation-geometry", "ablation-textures")
    for target in (*datasets, "test", "docs", "clean"):
        assert re.search(rf"^  {target}  ", listed, re.MULTILINE), target


def test_make_names_configs_that_exist() -> None:
    datasets = (*PACKAGED, "ablation-geometry", "ablation-textures")
    recipes = make("-n", *datasets, "IMAGES=photos")
    named = set(re.findall(r"generate --config (\S+)", recipes))
    assert named == {path.stem for path in (CHECKOUT / "configs").glob("*.yaml")}


def test_only_the_target_ablation_takes_the_images() -> None:
    recipes = make("-n", "ablation-textures", "IMAGES=photos")
    with_images = {line.split("--config ")[1].split()[0] for line in recipes.splitlines() if "--images" in line}
    assert with_images == {"ablation-textures-target"}


def test_a_sheet_shows_every_recipe_but_no_more_pairs_than_the_dataset_has() -> None:
    assert re.findall(r"preview .*--pairs (\d+)", make("-n", "eth3d", "PAIRS=3")) == ["3"]
    assert re.findall(r"preview .*--pairs (\d+)", make("-n", "zero-shot", "PAIRS=24")) == []


def test_ci_runs_both_targets_of_tests() -> None:
    script = (CHECKOUT / ".ci" / "run").read_text("utf-8")
    assert re.findall(r"^make .*", script, re.MULTILINE) == ["make test", "make test-heavy"]


# What tests need


def wanted(extra: str) -> set[str]:
    """Names of the packages of an extra, and of the extras that it takes in."""
    extras = tomllib.loads((CHECKOUT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    names = set()
    for requirement in extras[extra]:
        name, others = re.match(r"([\w-]+)(?:\[([\w,]+)\])?", requirement).groups()
        names |= set().union(*map(wanted, others.split(","))) if name == "semisynth-gl" else {name}
    return names


def test_large_packages_are_left_to_the_heavy_tests() -> None:
    large = {"ray", "torch", "torchdata", "triton", "nbclient", "ipykernel"}
    assert wanted("heavy") - wanted("dev") == large | wanted("docs") | {"markdown-it-py"}
    assert wanted("dev") < wanted("heavy")


def test_modules_that_need_a_large_package_are_marked() -> None:
    modules = Path(__file__).parents[1].rglob("*.py")
    needing = {path for path in modules if re.search(r"^\w+ = heavy\(", path.read_text("utf-8"), re.MULTILINE)}
    assert {path.name for path in needing} >= {"test_stream.py", "test_engines_ray.py"}
    for path in needing:
        assert "\npytestmark = pytest.mark.heavy\n" in path.read_text("utf-8"), path.name


def test_a_test_that_is_skipped_says_how_to_have_it() -> None:
    with pytest.raises(pytest.skip.Exception, match=r"^no_such is not installed: make test-heavy brings it$"):
        heavy("no_such.module")


def test_examples_are_the_same_in_every_run_and_random_ones_are_not() -> None:
    def examples(profile: str) -> list[int]:
        seen = []

        @settings(settings.get_profile(profile), database=None)
        @given(st.integers())
        def look(number: int) -> None:
            seen.append(number)

        look()
        return seen

    assert examples("fixed") == examples("fixed")
    assert examples("random") != examples("random")


# tools/browser-packages.sh


@pytest.fixture
def bare(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> Machine:
    monkeypatch.setattr(f"{__name__}.SCRIPT", CHECKOUT / "tools" / "browser-packages.sh")
    return machine


def test_root_gets_a_browser(bare: Machine) -> None:
    become_root(bare)
    code, said = bare.run()
    assert (code, said) == (0, "Installing chromium chromium-driver\n")
    assert bare.installed().splitlines()[-1].endswith("chromium chromium-driver")


def test_others_are_told_what_to_type_and_go_on(bare: Machine) -> None:
    code, said = bare.run()
    assert code == 0
    assert "apt-get install -y chromium chromium-driver" in said
    assert bare.installed() == ""


def test_a_system_without_that_package_goes_on(bare: Machine) -> None:
    become_root(bare)
    bare.offers("apt-cache", "exit 100\n")
    code, said = bare.run()
    assert code == 0
    assert "offers no package chromium-driver" in said
    assert "install" not in bare.installed()


def test_where_a_browser_is_nothing_is_done(bare: Machine) -> None:
    bare.offers("chromium", "")
    bare.offers("chromedriver", "")
    assert bare.run() == (0, "")
