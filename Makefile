# make demo      renders a built-in scene: the Verilog casts every ray, and all results are checked
# make test      runs all tests, in less than 20 minutes on two cores
# make full      runs all tests at full length: hours
# make evidence  measures and proves every claim of the README: a resumable campaign of several hours
# make rtl       refreshes rtl/ and constraints/, which tests compare with the generator's output
# make numbers   refreshes docs/numbers.md and its plots from docs/baseline.json
# make lint      checks formatting, clippy and documentation, with warnings as errors
# make deps      installs missing Debian packages, and Python packages into target/tools; demo, test, full and evidence call it if needed

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

# A campaign of jobs, each of which writes its report to target/campaign/. Finished jobs are not repeated while their program is the same
# (see sim/campaign/README.md). CAMPAIGN=sim/campaign/small.yaml selects a campaign of a few minutes.
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

# Folder of the Python packages.
ROUTERS := target/tools
export DYNRT_TOOLS ?= $(CURDIR)/$(ROUTERS)/bin

deps:
	@sim/deps.sh

# Installs only if something is missing.
ready:
	@sim/deps.sh --check || $(MAKE) --no-print-directory deps

# Snakemake runs the campaigns; the plug-in is for clusters under Slurm.
snakemake:
	@if ! PATH="$$DYNRT_TOOLS:$(CURDIR)/$(ROUTERS)/bin:$$PATH" command -v snakemake >/dev/null; then \
	    echo "installing snakemake into $(ROUTERS)"; \
	    { [ -x $(ROUTERS)/bin/python3 ] || python3 -m venv $(ROUTERS); } && \
	    $(ROUTERS)/bin/pip install --quiet 'snakemake>=9,<10' 'snakemake-executor-plugin-slurm>=2,<3'; \
	fi
