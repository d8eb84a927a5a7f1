# `make dragon` and `make test` need nothing but Python >= 3.10 and make; see `make help`.

NONEXP = .venv/bin/nonexp

.PHONY: help dragon test test-slow lint clean

help:
	@echo 'make dragon     render scenes/dragon.xml to out/dragon.exr and out/dragon.png'
	@echo 'make test       lint, types and tests'
	@echo 'make test-slow  tests with full-size statistics'
	@echo 'make lint       lint and types only'
	@echo 'make clean      remove .venv, out and caches'
	@echo
	@echo 'All of them first make .venv, with what they need. Other scenes, models and options:'
	@echo '.venv/bin/nonexp --help'

dragon: .venv/.installed
	mkdir -p out
	$(NONEXP) render scenes/dragon.xml -o out/dragon.exr

test: lint
	.venv/bin/python -m pytest

test-slow: .venv/.installed
	.venv/bin/python -m pytest --full

lint: .venv/.installed
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy

.venv/.installed: pyproject.toml tools/setup.sh
	sh tools/setup.sh
	touch $@

clean:
	rm -rf .venv out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find nonexp integrators tests -name __pycache__ -exec rm -rf {} +
