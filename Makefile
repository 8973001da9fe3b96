# All targets use the Python of .venv, so any virtual environment may be active, or none. `make help` lists the targets.

# The Python that makes .venv; if empty, scripts/find-python.sh looks for one.
PYTHON ?=
VENV := .venv
STAMP := $(VENV)/.installed
MUTATE := $(VENV)/.mutate
RUN := $(VENV)/bin/python -m
PYTEST_FLAGS ?= -q -n 2 --dist loadfile --no-loadscope-reorder
# The slow tests take as long as all others. They train, kill and start many processes.
SLOW ?= not slow
# The packages with further commands, which are installed from this tree.
ANNEXES := $(patsubst %/pyproject.toml,./%,$(wildcard $(foreach name,app benchmark inspect library test-object touchability,plugins_contrib/tactile-loc-$(name)/pyproject.toml)))

# ROS and others put their own packages, such as pytest plugins, before ours. Compiled modules are kept, because the tests
# start hundreds of processes.
unexport PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE

.PHONY: help setup demo test test-slow test-processors pytest lint smoke docs docs-quick notebooks audit sbom fuzz kill soak mutate benchmark bench bench-compare clean
.DEFAULT_GOAL := help

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-13s %s\n", $$1, $$2 }' Makefile

setup: $(STAMP) ## make .venv with everything pinned; does nothing when it is up to date
	@echo "setup: $(VENV) is ready"

demo: $(STAMP) ## locate a shipped object from three simulated touches, and draw it in out/demo
	@echo "demo: three touches, where is the object?"
	@$(VENV)/bin/tactile-loc run --out out/demo
	@for picture in out/demo/*.png; do if [ -e "$$picture" ]; then echo "demo: the picture is $$picture"; fi; done

test: $(STAMP) ## lint, check the types and run all tests that are not slow
	@PYTHON="$(PYTHON)" scripts/system-packages.sh --tests
	@$(MAKE) --no-print-directory --jobs 2 lint pytest

test-slow: $(STAMP) ## run the slow tests
	@$(MAKE) --no-print-directory pytest SLOW=slow

test-processors: $(STAMP) ## run the numerical tests as on other processors, 15 minutes
	@$(VENV)/bin/python scripts/processors.py

pytest: $(STAMP)
	@echo "test: pytest -m '$(SLOW)'"
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(RUN) pytest $(PYTEST_FLAGS) -m '$(SLOW)'

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

docs: notebooks ## build the documentation site in out/site, with the outputs of its notebooks
	@$(MAKE) --no-print-directory docs-quick

# --quiet would also hide warnings from --strict. So the output of mkdocs is shown only when it fails, each line once.
docs-quick: $(STAMP) ## build the site without executing notebooks; any warning is an error
	@echo "docs: out/site/index.html"
	@said=$$(NO_MKDOCS_2_WARNING=1 $(RUN) mkdocs build --strict 2>&1) || \
		{ printf '%s\n' "$$said" | grep -v '^INFO' | awk '!told[$$0]++' >&2; exit 1; }

notebooks: $(STAMP) ## execute the notebooks that have changed, about two minutes, into out/notebooks
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python scripts/notebooks.py

audit: $(STAMP) ## look for known vulnerabilities of the pinned packages; needs the internet
	@scripts/audit.sh $(VENV)/bin/python

sbom: $(STAMP) ## list the packages that the wheel installs, as CycloneDX, in out/sbom.cdx.json
	@scripts/sbom.sh $(VENV)/bin/python out/sbom.cdx.json

fuzz: $(STAMP) ## give every reader 2000 damaged inputs, half an hour; continues where it stopped
	@$(VENV)/bin/python scripts/fuzz.py

kill: $(STAMP) ## kill and starve commands, half an hour; continues where it stopped
	@$(VENV)/bin/python scripts/kill.py

soak: $(STAMP) ## locate 50000 touches and track for 2000 seconds in one process, an hour; nothing may grow
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python scripts/soak.py

mutate: $(MUTATE) ## change the numerical core in 700 places and run its tests, hours; continues where it stopped
	@$(VENV)/bin/python scripts/mutate.py

benchmark: $(STAMP) ## compare methods on touches from several sources, some minutes; continues where it stopped
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(VENV)/bin/tactile-loc benchmark --suite quick --out out/benchmark

bench: $(STAMP) ## run all benchmarks, hours, and keep their tables
	@$(VENV)/bin/python scripts/bench.py keep --all

bench-compare: $(STAMP) ## print the ratio of every figure of the benchmarks to its value before
	@$(VENV)/bin/python scripts/bench.py compare

clean: ## remove .venv, out, build and the tools' caches
	@echo "clean: removing .venv, out, build, dist and caches"
	@rm -rf .venv out build dist .mypy_cache .ruff_cache .pytest_cache *.egg-info

$(MUTATE): $(STAMP)
	@echo "mutate: installing cosmic-ray"
	@$(RUN) pip install -qq --disable-pip-version-check -c constraints.txt -e '.[mutate]'
	@touch $@

# A virtual environment contains its own path. After a copy or move of the folder it is made anew.
ifneq "$(shell cat $(STAMP) 2>/dev/null)" "$(CURDIR)"
.PHONY: $(STAMP)
endif

$(STAMP): pyproject.toml constraints.txt $(ANNEXES:=/pyproject.toml)
	@PYTHON="$(PYTHON)" scripts/system-packages.sh
	@if [ -e $(STAMP) ] && [ "$$(cat $(STAMP))" != "$(CURDIR)" ]; then rm -rf $(VENV); fi
	@python=$$(PYTHON="$(PYTHON)" scripts/find-python.sh) && \
		echo "setup: making $(VENV) with $$python" && "$$python" -m venv $(VENV)
	@echo "setup: installing the pinned packages, a minute or two the first time"
	@$(RUN) pip install -qq --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@$(if $(ANNEXES),$(RUN) pip install -qq --disable-pip-version-check --no-index --no-deps --no-build-isolation $(addprefix -e ,$(ANNEXES)))
	@echo "setup: compiling the kernels"
	@$(RUN) tactile_loc_cli.doctor.trials kernels > /dev/null || echo "setup: the kernels were not compiled; the first run reports the reason"
	@echo "$(CURDIR)" > $(STAMP)
