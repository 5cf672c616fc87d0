# Two targets are all a newcomer needs: `make run` and `make test`. Each sets up .venv once.
PYTHON ?= $(shell for p in python3 python3.12 python3.13 python3.11 python3.14; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
EXTRAS ?= dev,video,cluster,view,docs
BIN := .venv/bin
READY := .venv/.ready

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*##/\t/' | expand -t 12

setup: $(READY)  ## make .venv with the locked dependencies

$(READY): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "hoi needs Python 3.11 or newer; found none" \
		"(python3 is $$(python3 --version 2>&1)). Install one, or name it: make setup PYTHON=/path/to/python" >&2; exit 2; }
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[$(EXTRAS)]'
	@touch $(READY)

run: $(READY)  ## the default scene: record it, film it, draw a filmstrip, print the paths
	$(BIN)/python -m hoi.run $(ARGS)
	$(BIN)/python -m analysis.strip runs/kick_soccer_ball/laptop/full/s0/run.mcap

test: $(READY)  ## all tests, a file a core
	$(BIN)/python -m pytest -q -n auto --maxprocesses 4 --dist loadfile $(ARGS)

test-fast: $(READY)  ## what takes no second each, under two minutes on two cores: for each save
	$(BIN)/python -m pytest -q -m "not slow" -n auto --maxprocesses 4 --dist loadfile $(ARGS)

lint: $(READY)  ## ruff and the type checker
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/basedpyright

bench: $(READY)  ## seconds by stage of the default scene, of the person's answer, a step of the MPM, a gradient and a picture
	$(BIN)/python -m analysis.bench $(ARGS)
	$(BIN)/python -m analysis.answer_bench
	$(BIN)/python -m analysis.mpm_bench
	$(BIN)/python -m analysis.gradient_bench
	$(BIN)/python -m analysis.render_bench
	$(BIN)/python -m analysis.film_bench

precision: $(READY)  ## error against run time of physics, renderer and stage 3: tables, reports, pictures in runs/precision
	$(BIN)/python -m analysis.precision $(ARGS)

table: $(READY)  ## the table of all runs, from their records
	$(BIN)/python -m analysis.table runs $(ARGS)

report: $(READY)  ## one HTML page of all runs: tables, filmstrips, videos, plans, timings
	$(BIN)/python -m analysis.report runs $(ARGS)

stability: $(READY)  ## extreme cases of the object's MPM: a map of where it holds
	$(BIN)/python -m analysis.stability $(ARGS)

reality: $(READY)  ## drops, rolling, sliding, sand against published numbers: table and plot in runs/reality
	$(BIN)/python -m analysis.reality $(ARGS)

sweep: $(READY)  ## the benchmark on all cores: ten scenes, the method and its ablations
	$(BIN)/python -m hoi.run --config-dir sweeps --config-name ablations hydra/launcher=joblib $(ARGS)

variations: $(READY)  ## what the paper varies within a scene
	$(BIN)/python -m hoi.run --config-dir sweeps --config-name variations hydra/launcher=joblib $(ARGS)

smoke: $(READY)  ## a small sweep of every kind of run
	$(BIN)/python -m hoi.run --config-dir sweeps --config-name smoke hydra/launcher=joblib $(ARGS)

docs: $(READY)  ## the documentation as a site, into site/: open site/index.html
	@$(BIN)/python -c 'import material' 2>/dev/null || $(BIN)/pip install --quiet --constraint constraints.txt --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

clean:  ## remove the environment, the runs and the site
	rm -rf .venv runs site

.PHONY: help setup run test test-fast lint bench precision table report stability reality sweep variations smoke docs clean
