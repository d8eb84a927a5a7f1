# `make dragon` and `make test` need nothing but Python >= 3.10 and make; see `make help`.

NONEXP = .venv/bin/nonexp

.PHONY: help dragon test test-all test-slow bench lint docs gallery clean

help:
	@echo 'make dragon     render scenes/dragon.xml to out/dragon.exr and out/dragon.png'
	@echo 'make test       lint, types and the quick tests: all but those marked thorough (4 minutes)'
	@echo 'make test-all   all tests (15 minutes)'
	@echo 'make test-slow  all tests with full statistics (hours)'
	@echo 'make bench      run time against error beside Mitsuba, into docs/benchmarks (16 minutes)'
	@echo 'make lint       lint and types only'
	@echo 'make docs       documentation, notebooks executed, in out/docs/docs/index.html'
	@echo 'make gallery    pictures of all models, docs/gallery.md; goes on where it was stopped'
	@echo 'make clean      remove .venv, out and caches'
	@echo
	@echo 'All of them first make .venv, with what they need. Other scenes, models and options:'
	@echo '.venv/bin/nonexp --help'

dragon: .venv/.installed
	mkdir -p out
	$(NONEXP) render scenes/dragon.xml -o out/dragon.exr

test: lint
	.venv/bin/python -m pytest --quick

test-all: .venv/.installed
	.venv/bin/python -m pytest

test-slow: .venv/.installed
	.venv/bin/python -m pytest --full

bench: .venv/.installed
	$(NONEXP) bench --out docs/benchmarks

lint: .venv/.installed
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy

# Warnings are errors. DOCS='-D nb_execution_mode=off' leaves the notebooks as they are (seconds).
docs: .venv/.installed
	.venv/bin/python -m sphinx -W --keep-going -c docs $(DOCS) . out/docs

# Half an hour on two cores; GALLERY='--spp 64 --size 192x144' for a look.
gallery: .venv/.installed
	.venv/bin/python tools/gallery.py $(GALLERY)

.venv/.installed: pyproject.toml tools/setup.sh
	sh tools/setup.sh
	touch $@

clean:
	rm -rf .venv out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find nonexp integrators tests -name __pycache__ -exec rm -rf {} +
