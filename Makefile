# Every target makes what it needs. Windows and macOS without make: python3.11 scripts/dev.py TARGET
PYTHON ?= $(shell command -v python3.11 || command -v python3)
DEV = $(PYTHON) scripts/dev.py

.PHONY: env test test-faults demo bench lint docs reference extension
env:            ## .venv with .venv/bin/chona
	$(DEV) env
test:           ## lint, types and all tests but slow ones
	$(DEV) test
test-faults:    ## kills, full disks and bad input, many times over; hours
	$(DEV) test-faults
demo:           ## the whole job: capture, train, pose, bake, composite -> demo/out
	$(DEV) demo
bench:          ## speed, and what it costs -> benchmarks/results; ARGS='--data D …' for another capture than the demo's
	$(DEV) bench $(ARGS)
lint:           ## ruff and mypy
	$(DEV) lint
docs:           ## the manual -> site/; fails on a broken link
	$(DEV) docs
reference:      ## docs/reference, from the sources
	$(DEV) reference
extension:      ## dist/chona-VERSION.zip for Blender
	$(DEV) extension
