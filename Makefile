# make demo   a picture of a built-in scene, every ray of it cast by the Verilog and checked
# make test   the tests, in less than 20 minutes on two cores
# make full   the tests at full length: hours
# make evidence  everything that the README claims, in full: a campaign of hours; goes on from its finished jobs where it was cut off
# make rtl    refresh rtl/ and constraints/, which tests hold to what the program generates
# make numbers  refresh docs/numbers.md and its plots from docs/baseline.json
# make lint   formatting, clippy and documentation, without a warning
# make deps   install what is missing: Debian packages, and Python packages into target/tools; demo, test, full and evidence call it if so

DEMO_SCENE := builtin:interior --view inside
DEMO_OUT   := demo.png

.PHONY: demo test full evidence rtl numbers lint deps ready snakemake
SHELL := /bin/bash
.SHELLFLAGS := -e -o pipefail -c
.DEFAULT_GOAL := demo

demo: ready
	cargo run --release --quiet -- cosim $(DEMO_SCENE) --size 512x384 --out $(DEMO_OUT)

test: ready
	cargo test --workspace

full: ready
	DYNRT_FULL=1 cargo test --workspace

# A campaign of jobs, each of which leaves its report in target/campaign/: what is done with the same program is not done again, and what
# was cut off goes on from there (sim/campaign/README.md). With CAMPAIGN=sim/campaign/small.yaml it is another, of a few minutes.
CAMPAIGN := sim/campaign/config.yaml

evidence: ready snakemake
	sim/campaign/run.sh --configfile $(CAMPAIGN) --profile sim/campaign/profiles/local

numbers:
	cargo run --release --quiet -- numbers

rtl:
	cargo run --release --quiet -- generate --out rtl
	cargo run --release --quiet -- constraints --out constraints

lint:
	cargo fmt --all --check
	cargo clippy --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --quiet

# Where Python packages are installed, and looked for.
ROUTERS := target/tools
export DYNRT_TOOLS ?= $(CURDIR)/$(ROUTERS)/bin

deps:
	@sim/deps.sh

# Installs only if something is missing.
ready:
	@sim/deps.sh --check || $(MAKE) --no-print-directory deps

# What runs campaigns, with the plug-in for clusters under Slurm.
snakemake:
	@if ! PATH="$$DYNRT_TOOLS:$(CURDIR)/$(ROUTERS)/bin:$$PATH" command -v snakemake >/dev/null; then \
	    echo "installing snakemake into $(ROUTERS)"; \
	    { [ -x $(ROUTERS)/bin/python3 ] || python3 -m venv $(ROUTERS); } && \
	    $(ROUTERS)/bin/pip install --quiet 'snakemake>=9,<10' 'snakemake-executor-plugin-slurm>=2,<3'; \
	fi
