# Everything is done with the Python of .venv, so it does not matter which virtual environment is active, or whether
# one is. `make help` lists the targets.

# The Python that .venv is made with; empty: scripts/find-python.sh looks for one.
PYTHON ?=
VENV := .venv
STAMP := $(VENV)/.installed
MUTATE := $(VENV)/.mutate
RUN := $(VENV)/bin/python -m
PYTEST_FLAGS ?= -q -n 2 --dist loadfile --no-loadscope-reorder

# ROS and others put their own packages, pytest plugins among them, in front of ours. And what is started hundreds of
# times, as by the tests, is compiled once.
unexport PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE

.PHONY: help setup demo test pytest lint smoke docs audit sbom fuzz kill soak mutate bench bench-compare clean
.DEFAULT_GOAL := help

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-13s %s\n", $$1, $$2 }' Makefile

setup: $(STAMP) ## make .venv with everything pinned; does nothing when it is up to date
	@echo "setup: $(VENV) is ready"

demo: $(STAMP) ## locate a shipped object from one shipped touch, and draw it in out/demo
	@echo "demo: one touch, where is the object?"
	@$(VENV)/bin/tactile-loc run --seed 7 --out out/demo
	@for picture in out/demo/*.png; do if [ -e "$$picture" ]; then echo "demo: the picture is $$picture"; fi; done

test: $(STAMP) ## lint, check the types and run the tests
	@PYTHON="$(PYTHON)" scripts/system-packages.sh --tests
	@$(MAKE) --no-print-directory --jobs 2 lint pytest

pytest: $(STAMP)
	@echo "test: pytest"
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(RUN) pytest $(PYTEST_FLAGS)

lint: $(STAMP) ## check style, format, types and English
	@echo "lint: ruff check"
	@$(RUN) ruff check --quiet
	@echo "lint: ruff format --check"
	@$(RUN) ruff format --check --quiet
	@echo "lint: mypy"
	@$(RUN) mypy --no-error-summary
	@echo "lint: prose"
	@$(VENV)/bin/python scripts/check_prose.py

smoke: $(STAMP) ## build the wheel, install it into a fresh environment and try it there
	@scripts/smoke-wheel.sh $(VENV)/bin/python

# --quiet would hide warnings from --strict too, so what mkdocs says is shown only when it fails, each line once.
docs: $(STAMP) ## build the documentation site in out/site; any warning is an error
	@echo "docs: out/site/index.html"
	@said=$$(NO_MKDOCS_2_WARNING=1 $(RUN) mkdocs build --strict 2>&1) || \
		{ printf '%s\n' "$$said" | grep -v '^INFO' | awk '!told[$$0]++' >&2; exit 1; }

audit: $(STAMP) ## look the pinned packages up among known vulnerabilities; needs the internet
	@scripts/audit.sh $(VENV)/bin/python

sbom: $(STAMP) ## list what the wheel brings with it, as CycloneDX, in out/sbom.cdx.json
	@scripts/sbom.sh $(VENV)/bin/python out/sbom.cdx.json

fuzz: $(STAMP) ## give every reader 2000 damaged inputs, half an hour; the same again goes on where it was stopped
	@$(VENV)/bin/python scripts/fuzz.py

kill: $(STAMP) ## kill and starve commands, half an hour; the same again goes on where it was stopped
	@$(VENV)/bin/python scripts/kill.py

soak: $(STAMP) ## locate 50000 touches and track for 2000 seconds in one process, an hour; nothing may grow
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python scripts/soak.py

mutate: $(MUTATE) ## change the numerical core in 700 places, hours, and see whether tests notice; the same again goes on
	@$(VENV)/bin/python scripts/mutate.py

bench: $(STAMP) ## run all benchmarks, hours, and keep what they print
	@$(VENV)/bin/python scripts/bench.py keep --all

bench-compare: $(STAMP) ## tell what benchmarks print otherwise than in the version before
	@$(VENV)/bin/python scripts/bench.py compare

clean: ## remove .venv, out, build and the tools' caches
	@echo "clean: removing .venv, out, build, dist and caches"
	@rm -rf .venv out build dist .mypy_cache .ruff_cache .pytest_cache *.egg-info

$(MUTATE): $(STAMP)
	@echo "mutate: installing cosmic-ray"
	@$(RUN) pip install -qq --disable-pip-version-check -c constraints.txt -e '.[mutate]'
	@touch $@

# A virtual environment holds its own path: one that was copied or moved here is made anew.
ifneq "$(shell cat $(STAMP) 2>/dev/null)" "$(CURDIR)"
.PHONY: $(STAMP)
endif

$(STAMP): pyproject.toml constraints.txt
	@PYTHON="$(PYTHON)" scripts/system-packages.sh
	@if [ -e $(STAMP) ] && [ "$$(cat $(STAMP))" != "$(CURDIR)" ]; then rm -rf $(VENV); fi
	@python=$$(PYTHON="$(PYTHON)" scripts/find-python.sh) && \
		echo "setup: making $(VENV) with $$python" && "$$python" -m venv $(VENV)
	@echo "setup: installing the pinned packages, a minute or two the first time"
	@$(RUN) pip install -qq --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@echo "setup: compiling what locating takes"
	@$(RUN) tactile_loc_cli.doctor.trials kernels > /dev/null || echo "setup: that failed; the first run will say why"
	@echo "$(CURDIR)" > $(STAMP)
