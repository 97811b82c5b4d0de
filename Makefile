# `make` lists the targets. Each target first installs what it needs: the environment .venv, and OpenGL.

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
# The tests start hundreds of processes: without cached bytecode, each would compile all modules.
unexport PYTHONDONTWRITEBYTECODE

CONFIGS := middlebury kitti eth3d sceneflow zero-shot active-infrared
GEOMETRIES := ablation-geometry-simple ablation-geometry-complex

backend := $(if $(BACKEND),$(BACKEND),auto)
ifeq ($(filter $(backend),auto egl osmesa),)
$(error BACKEND must be auto, egl or osmesa, not $(BACKEND))
endif
scene_options = --seed $(SEED) --backend $(backend) $(if $(MODELS),--models "$(MODELS)")
with_images = $(if $(IMAGES),--images "$(IMAGES)")
# The contact sheet has a pair of each recipe, and at least four pairs, but not more than the dataset.
shown = $(if $(filter 1 2 3,$(PAIRS)),--pairs $(PAIRS))

# $(call render,CONFIG,IMAGE OPTIONS): a dataset and its contact sheet.
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

# IMAGES replaces only the photographs of the target.
.PHONY: ablation-textures
ablation-textures: setup  ## procedural textures, photographs, and with IMAGES= the target's photographs
	$(call render,ablation-textures-procedural)
	$(call render,ablation-textures-photos)
	$(if $(IMAGES),$(call render,ablation-textures-target,$(with_images)),\
	@echo "Without ablation-textures-target: give its photographs, make ablation-textures IMAGES=path" >&2)

# The tests run even if lint fails, so that one run shows all faults.
.PHONY: test
test: $(VENV)/.dev  ## lint, and the tests without PyTorch and Ray, on EGL and OSMesa where they are installed
	@sh tools/system-packages.sh $(VENV)/bin/python $(system)
	@status=0; \
	$(MAKE) --no-print-directory lint || status=1; \
	$(VENV)/bin/python -m pytest --numprocesses auto --dist worksteal || status=1; \
	exit $$status

# In `make test`, property tests always try the same examples. Here the commit's hash seeds them, so that they are new in
# each commit, but the same for everybody. EXAMPLES=4711 gives another seed.
EXAMPLES ?= $(shell printf %d 0x$$(git rev-parse --short=7 HEAD 2>/dev/null || echo 0))
.PHONY: test-heavy
test-heavy: $(VENV)/.heavy  ## tests with PyTorch and Ray (GBs to download), and property tests on random examples
	@sh tools/system-packages.sh $(VENV)/bin/python $(system)
	$(VENV)/bin/mypy
	$(VENV)/bin/python -m pytest --numprocesses auto --dist worksteal -m "heavy or hypothesis" \
	    --hypothesis-profile random --hypothesis-seed $(EXAMPLES)

# The variable turns off mkdocs-material's notice about its successor.
.PHONY: docs
docs: build/gallery/.drawn $(VENV)/.docs  ## build the documentation as a site into build/docs, pictures and all
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/python -m mkdocs build --quiet --strict
	@echo "Open build/docs/index.html"

# The prerequisites are all files on which a picture may depend.
build/gallery/.drawn: docs/make_gallery.py $(shell find semisynth_gl shaders configs assets -type f ! -name '*.pyc') | setup
	@echo "Rendering the gallery's pictures, which takes minutes without a GPU"
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
setup: $(VENV)/.installed  ## the environment in VENV, and OpenGL's libraries if they are missing
	@sh tools/system-packages.sh $(VENV)/bin/python $(system)

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

# What system-packages.sh checks, before anything is downloaded: prerequisites inherit a target's variables. Lint and
# doctor need no OpenGL.
setup docs: system := $(backend)
test test-heavy: system := egl osmesa chromium

# The stamp files are inside the environment, so that removing the environment removes them.
$(VENV)/.made:
	@sh tools/system-packages.sh $(PYTHON) $(system)
	$(PYTHON) -m venv $(VENV)
	@touch $@

install = $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --editable

$(VENV)/.installed: pyproject.toml $(VENV)/.made
	@echo "Installing semisynth-gl and its dependencies into $(VENV)"
	$(install) .
	@touch $@

$(VENV)/.dev: pyproject.toml $(VENV)/.made
	@echo "Installing semisynth-gl and the dependencies of its tests into $(VENV)"
	$(install) ".[dev]"
	@touch $(VENV)/.installed $@

$(VENV)/.docs: pyproject.toml $(VENV)/.made
	@echo "Installing semisynth-gl and the dependencies of its documentation into $(VENV)"
	$(install) ".[docs]"
	@touch $(VENV)/.installed $@

$(VENV)/.heavy: pyproject.toml $(VENV)/.made
	@echo "Installing semisynth-gl and the dependencies of all tests, such as PyTorch, into $(VENV)"
	$(install) ".[heavy]"
	@touch $(VENV)/.installed $(VENV)/.dev $(VENV)/.docs $@
