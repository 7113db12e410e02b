# make demo   a picture of a built-in scene, every ray of it cast by the Verilog and checked
# make test   the tests, in less than 20 minutes on two cores
# make full   the tests at full length: hours
# make rtl    refresh rtl/ and constraints/, which tests hold to what the program generates
# make lint   formatting and clippy
# make tools  install what of the above is missing (Debian packages; asks for nothing)

DEMO_SCENE := builtin:interior --view inside
DEMO_OUT   := demo.png

.PHONY: demo test full rtl lint tools
.DEFAULT_GOAL := demo

demo: tools
	cargo run --release --quiet -- cosim $(DEMO_SCENE) --size 512x384 --out $(DEMO_OUT)

test: tools
	cargo test

full: tools
	DYNRT_FULL=1 cargo test

rtl:
	cargo run --release --quiet -- generate --out rtl
	cargo run --release --quiet -- constraints --out constraints

lint:
	cargo fmt --check
	cargo clippy --all-targets -- -D warnings

# A package is installed only if what it provides is absent, so that no root is needed where all is there.
tools:
	@missing=; \
	for tool in verilator iverilog yosys z3 g++; do \
	    command -v $$tool >/dev/null || missing="$$missing $$tool"; \
	done; \
	[ -e /usr/include/zlib.h ] || missing="$$missing zlib1g-dev"; \
	if [ -n "$$missing" ]; then \
	    echo "installing$$missing"; \
	    as_root=; [ "$$(id -u)" = 0 ] || as_root=sudo; \
	    $$as_root apt-get update -q && \
	    $$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends $$missing; \
	fi
