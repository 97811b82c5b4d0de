# `make` lists what can be made. Every target sets up what it needs: the environment in .venv, OpenGL's libraries.

PYTHON ?= python3
VENV ?= .venv
PAIRS ?= 24
SEED ?= 0
OUT ?= out
IMAGES ?=
MODELS ?=
BACKEND ?=

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
MAKEFLAGS += --no-builtin-rules
# The tests start hundreds of programs, and without bytecode each compiles all modules again.
unexport PYTHONDONTWRITEBYTECODE

CONFIGS := middlebury kitti eth3d sceneflow zero-shot active-infrared
GEOMETRIES := ablation-geometry-simple ablation-geometry-complex

backend := $(if $(BACKEND),$(BACKEND),auto)
ifeq ($(filter $(backend),auto egl osmesa),)
$(error BACKEND must be auto, egl or osmesa, not $(BACKEND))
endif
scene_options = --seed $(SEED) --backend $(backend) $(if $(MODELS),--models "$(MODELS)")
with_images = $(if $(IMAGES),--images "$(IMAGES)")
# A sheet shows a pair of each recipe, four at least, but no more pairs than a small dataset has.
shown = $(if $(filter 1 2 3,$(PAIRS)),--pairs $(PAIRS))

# $(call render,CONFIG,IMAGE OPTIONS): a dataset, and a contact sheet beside it.
define render
$(VENV)/bin/semisynth-gl generate --config $(1) --out $(OUT)/$(1) --pairs $(PAIRS) --overwrite $(scene_options) $(2)
$(VENV)/bin/semisynth-gl preview --config $(1) --out $(OUT)/$(1).png $(shown) $(scene_options) $(2)

endef

.PHONY: help
help:  ## list the targets
	@echo "make TARGET [PAIRS=24] [SEED=0] [IMAGES=photographs] [MODELS=folder] [BACKEND=egl|osmesa] [OUT=out]"
	@echo "            [PYTHON=python3] [VENV=.venv]"
	@awk -F ':.*## ' '/^[a-z].*## / { printf "  %-60s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

.PHONY: $(CONFIGS)
middlebury kitti eth3d sceneflow zero-shot active-infrared: setup  ## render PAIRS pairs to OUT/<name>, in the layout of that benchmark, with a contact sheet
	$(call render,$@,$(with_images))

.PHONY: ablation-geometry
ablation-geometry: setup  ## the same scenes from simple models only, and from complex ones only
	$(foreach config,$(GEOMETRIES),$(call render,$(config),$(with_images)))

# Procedural textures and free photographs stay what they are: IMAGES are the target's.
.PHONY: ablation-textures
ablation-textures: setup  ## procedural textures, photographs, and with IMAGES= the target's photographs
	$(call render,ablation-textures-procedural)
	$(call render,ablation-textures-photos)
	$(if $(IMAGES),$(call render,ablation-textures-target,$(with_images)),\
	@echo "Left out: the target's photographs. To add them: make ablation-textures IMAGES=path" >&2)

# Lint's complaints do not keep the tests from running: one run shows all that is wrong.
.PHONY: test
test: $(VENV)/.dev  ## lint, and the tests without PyTorch and Ray, on EGL and OSMesa where they are installed
	@sh tools/system-packages.sh $(VENV)/bin/python $(opengl)
	@sh tools/browser-packages.sh
	@status=0; \
	$(MAKE) --no-print-directory lint || status=1; \
	$(VENV)/bin/python -m pytest --numprocesses auto --dist worksteal || status=1; \
	exit $$status

# Examples of the property tests are the same in each run of test, and others here in each commit: a commit is red for
# everybody, or for nobody. EXAMPLES=4711 tries others.
EXAMPLES ?= $(shell printf %d 0x$$(git rev-parse --short=7 HEAD 2>/dev/null || echo 0))
.PHONY: test-heavy
test-heavy: $(VENV)/.heavy  ## tests with PyTorch and Ray (GBs to download), and property tests on random examples
	@sh tools/browser-packages.sh
	$(VENV)/bin/mypy
	$(VENV)/bin/python -m pytest --numprocesses auto --dist worksteal -m "heavy or hypothesis" \
	    --hypothesis-profile random --hypothesis-seed $(EXAMPLES)

# Material announces its successor in each build.
.PHONY: docs
docs: build/gallery/.drawn $(VENV)/.docs  ## build the documentation as a site into build/docs, pictures and all
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --quiet --strict
	@echo "Open build/docs/index.html"

# Everything that a picture may depend on.
build/gallery/.drawn: docs/make_gallery.py $(shell find semisynth_gl shaders configs assets -type f ! -name '*.pyc') | setup
	@echo "Drawing the gallery's pictures, which takes minutes without a GPU"
	rm -rf build/gallery
	$(VENV)/bin/python docs/make_gallery.py build/gallery
	@touch $@

.PHONY: lint
lint: $(VENV)/.dev  ## ruff, mypy, and import-linter for the rooms
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports --no-logo

.PHONY: format
format: $(VENV)/.dev  ## let ruff rewrite the Python files
	$(VENV)/bin/ruff check --fix .
	$(VENV)/bin/ruff format .

.PHONY: setup
setup: $(VENV)/.installed  ## the environment in VENV, and OpenGL's libraries where they are missing
	@sh tools/system-packages.sh $(VENV)/bin/python $(opengl)

.PHONY: doctor
doctor: $(VENV)/.installed  ## show what OpenGL this machine offers, and test it
	$(VENV)/bin/semisynth-gl doctor

.PHONY: release-check
release-check:  ## build sdist and wheel into dist/, check them, and use the wheel in a fresh environment
	@sh tools/system-packages.sh $(PYTHON) $(backend)
	@sh tools/release-check.sh $(PYTHON)

.PHONY: clean
clean:  ## remove the environment, caches and built packages; datasets in OUT stay
	[ ! -f $(VENV)/pyvenv.cfg ] || rm -rf $(VENV)
	rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find $(wildcard semisynth_gl tests benchmarks examples docs) -type d -name __pycache__ -exec rm -rf {} +

# Make hands these down to what setup and test need, so that a machine without OpenGL's libraries says so before it
# downloads anything. Lint and doctor run without.
setup docs: opengl := $(backend)
test test-heavy: opengl := egl osmesa

# The stamps lie in the environment, so that they go when it goes.
$(VENV)/.made:
	@sh tools/system-packages.sh $(PYTHON) $(opengl)
	$(PYTHON) -m venv $(VENV)
	@touch $@

install = $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --editable

$(VENV)/.installed: pyproject.toml $(VENV)/.made
	@echo "Installing semisynth-gl and what it needs into $(VENV)"
	$(install) .
	@touch $@

$(VENV)/.dev: pyproject.toml $(VENV)/.made
	@echo "Installing semisynth-gl, what it needs and what its tests need into $(VENV)"
	$(install) ".[dev]"
	@touch $(VENV)/.installed $@

$(VENV)/.docs: pyproject.toml $(VENV)/.made
	@echo "Installing semisynth-gl, what it needs and what its documentation needs into $(VENV)"
	$(install) ".[docs]"
	@touch $(VENV)/.installed $@

$(VENV)/.heavy: pyproject.toml $(VENV)/.made
	@echo "Installing semisynth-gl and what all of its tests need, PyTorch among it, into $(VENV)"
	$(install) ".[heavy]"
	@touch $(VENV)/.installed $(VENV)/.dev $(VENV)/.docs $@
