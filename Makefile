# make          prints this list
# make render   renders a sample scene with Lobe into out/
# make test     everything that must hold: style, types, tests
# make test-long  the tests that take minutes, and the tables of accuracy in benchmarks/results/
# make test-gui   Lobe in a Blender with a window, which LOBE_BLENDER_WINDOW names; the pictures end up in out/gui/
# make bench    error against time beside Cycles, into benchmarks/results/: about an hour and a half; it can be interrupted
# make package  the extension with its wheels, a zip for each system, into out/
# make clean    removes .venv, out/ and what is kept in the temporary folder, see README.md
# Each makes .venv from the pinned requirements when it is missing or they have changed.

PYTHON ?= python3.11
VENV := .venv
RUN := $(VENV)/bin/python
INSTALLED := $(VENV)/installed

.PHONY: help render test test-long test-gui bench lint types package venv clean

help:
	@sed -n '/^#/!q;s/^# //p' Makefile

render: $(INSTALLED)
	mkdir -p out
	$(RUN) tools/render.py sample_blends/plates_phong.blend -o out/plates_phong.png -o out/plates_phong.exr

# By default files with few tests come last, and the slowest are among them.
test: lint types
	$(RUN) -m pytest -n 2 --dist loadfile --no-loadscope-reorder

test-long: $(INSTALLED)
	status=0; \
	$(RUN) -m pytest -m long -s || status=1; \
	$(RUN) benchmarks/parity.py all --against REFERENCE || status=1; \
	$(RUN) benchmarks/parity.py all --against CYCLES || status=1; \
	exit $$status

test-gui: $(INSTALLED)
	@window=$$($(RUN) -c 'from tests.blender.real_blender import named; print(named())') && \
	LOBE_BLENDER_WINDOW="$$window" $(RUN) -m pytest tests/blender/test_gui.py tests/blender/test_viewport_window.py tests/blender/test_compare_window.py

bench: $(INSTALLED)
	$(RUN) tools/bench.py cornell_diffuse --osl
	$(RUN) tools/bench.py all

lint: $(INSTALLED)
	$(RUN) -m ruff check .
	$(RUN) -m ruff format --check .

types: $(INSTALLED)
	$(RUN) -m mypy engine tools

package: $(INSTALLED)
	$(RUN) tools/package.py -o out

venv: $(INSTALLED)

$(INSTALLED): requirements.txt requirements-dev.txt
	@command -v $(PYTHON) >/dev/null || { echo "Python 3.11 is needed (set PYTHON=... if it has another name)"; exit 1; }
	@echo "Fetching the developers' tools into $(VENV), Blender as a Python module among them: some minutes"
	test -x $(RUN) || $(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --disable-pip-version-check -r requirements-dev.txt
	touch $(INSTALLED)

clean:
	$(PYTHON) -c 'from tools.lobe_blender import clean; clean()'
	rm -rf $(VENV) out
