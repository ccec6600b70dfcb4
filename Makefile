# make demo: from nothing to a map. The other targets: setup test lint bench eval deb deb-test hil
# vm-test browser interop faults readers formats.
.DEFAULT_GOAL := demo
.PHONY: setup demo test lint bench eval eval-model deb deb-test hil vm-test browser interop faults readers formats

CALM_EDGE := .venv/bin/python -m calm_edge.cli
DEMO_DRIVE ?= demo/drive
DEMO_OUT ?= build/demo
# the spacing the demo rig was rendered with; without it the map is in spacings
DEMO_SPACING_M ?= 0.5
DEMO_PACE ?= lockstep

setup: .venv/.stamp

DECLARED := pyproject.toml constraints.txt deploy/setup.sh
# EXTRAS of pyproject.toml, such as oak,import; each only if it is needed, for their size
EXTRAS ?=
.venv/.stamp: $(DECLARED)
	@deploy/setup.sh "$(EXTRAS)" && touch $@

# what tests and lints besides
.venv/.stamp-dev: $(DECLARED)
	@deploy/setup.sh oak,import,laz,geo,dask,dev && touch .venv/.stamp $@

demo: setup
	@rm -rf $(DEMO_OUT) && mkdir -p $(DEMO_OUT)
	@echo "demo 1/3: record, replaying $(DEMO_DRIVE) through the real daemon" >&2
	$(CALM_EDGE) record --sequence $(DEMO_DRIVE) --spacing-m $(DEMO_SPACING_M) --pace $(DEMO_PACE) --out $(DEMO_OUT)/recording
	@echo "demo 2/3: map" >&2
	$(CALM_EDGE) map $(DEMO_OUT)/recording --truth $(DEMO_DRIVE) --out $(DEMO_OUT)/map
	@echo "demo 3/3: error against the ground truth" >&2
	$(CALM_EDGE) eval $(DEMO_OUT)/map --truth $(DEMO_DRIVE)
	@echo "recording       $(DEMO_OUT)/recording"
	@echo "report          $(DEMO_OUT)/map/report.html"
	@echo "map to look at  $(DEMO_OUT)/map/map.html"
	@echo "its points      $(DEMO_OUT)/map/map.ply"

# what runs in real time runs alone: faults are judged by what they cost, not by a busy machine.
# Freed memory is kept: giving pages back and asking for them anew is half the time of the tests
test: export MALLOC_MMAP_MAX_ := 0
test: export MALLOC_TRIM_THRESHOLD_ := 8000000000
test: .venv/.stamp-dev
	.venv/bin/python -m pytest -n 2 --dist loadfile --ignore tests/faults
	.venv/bin/python -m pytest tests/faults

lint: .venv/.stamp-dev
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	.venv/bin/lint-imports

# a recording in the MCAP readers of Python, Rust, JavaScript and rerun, as far as they are
# installed; RECORDING=drives/monday for that instead of a small one
readers: .venv/.stamp-dev
	.venv/bin/python -m tests.interop.readers $(RECORDING)

# every format in and out, opened by readers of other makers; MAP=maps/monday TRUTH=FOLDER for that
formats: .venv/.stamp-dev
	.venv/bin/python -m tests.interop.formats $(MAP) $(TRUTH)

# what is done to the daemon, and what comes of it; FAULTS="kill disk" does some rows only
faults: .venv/.stamp-dev
	.venv/bin/python -m tests.faults.table $(FAULTS)

# report.html, map.html, the live page and that of setup used in headless Chromium with software rendering; skips without it
browser: .venv/.stamp-dev
	.venv/bin/python -m pytest -rs tests/browser/report_in_browser.py \
		tests/browser/map_in_browser.py tests/browser/live_in_browser.py \
		tests/browser/setup_in_browser.py

# what we send over the serial line, read by a Rust and a Node decoder; skips what is not here
interop: .venv/.stamp-dev
	.venv/bin/python -m tests.interop.mavlink_decoders

# 3: completed with loss, which a machine that is too slow or too busy does
bench: setup
	@rm -rf build/bench
	$(CALM_EDGE) record --sequence $(DEMO_DRIVE) --spacing-m $(DEMO_SPACING_M) --pace realtime --out build/bench || [ $$? -eq 3 ]
	$(CALM_EDGE) eval build/bench --truth $(DEMO_DRIVE)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m bench cost build/bench
	.venv/bin/python -m bench cost.start
	.venv/bin/python -m bench cost.load --pictures build/bench_pictures --drive $(DEMO_DRIVE)

# every table of the report; one that misses a target stops none of the others
eval: setup
	@failed=0; \
	measure() { \
		echo "eval: python -m bench $$*" >&2; \
		.venv/bin/python -m bench "$$@" || failed=1; \
	}; \
	measure targets; \
	measure kilometres.tables; \
	for drive in demo=demo/drive aalborg=build/sim/aalborg; do \
		recording=build/eval/$${drive%%=*}/recording; \
		[ -d $$recording ] || { echo "eval: skipped, $$recording is not here" >&2; continue; }; \
		measure mapping $$recording --truth $${drive#*=}; \
		measure mapping $$recording --truth $${drive#*=} --warp 0.05; \
	done; \
	measure pixels; \
	measure tables; \
	exit $$failed

# the packages for this release, into build/deb; ARCH=arm64 for that instead of this machine
deb: setup
	@.venv/bin/python -m deploy.build_deb --arch "$(ARCH)"

# installs, uses, upgrades and removes them in a Debian tree of its own; needs root and debootstrap
# ARCH=arm64: installs, records, maps and compares in a tree of that architecture, emulated by QEMU
FRAMES ?= 12
deb-test: .venv/.stamp-dev
ifeq ($(ARCH),)
	@.venv/bin/python -m deploy.try_deb
else
	@.venv/bin/python -m deploy.try_foreign_deb --arch "$(ARCH)" --frames $(FRAMES)
endif

# bring-up of a real kit: hil_tests/README.md says what to plug in; HIL="2 3" picks tests
hil: setup
	@.venv/bin/python -m hil_tests $(HIL)

# the package, power cuts and failing disks on an emulated machine; hil_tests/vm/README.md
vm-test: .venv/.stamp-dev
	@.venv/bin/python -m hil_tests.vm $(VM)

# what the learned model has to beat, on pictures and on whole drives, and whether it does
eval-model: setup
	@failed=0; \
	for part in matches depth places clips pipeline; do \
		OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m bench model.$$part || failed=1; \
	done; \
	exit $$failed
