#!/bin/sh
# The self-test in Icarus Verilog: prints PASS or FAIL with the checksum of the hits.
set -eu
cd "$(dirname -- "$0")"
mkdir -p build
need() {
    package=$1
    shift
    for tool; do
        if command -v "$tool" >/dev/null; then echo "$tool"; return; fi
    done
    echo "error: $1 is not installed: $package" >&2
    exit 1
}
configuration() {
    sed -n '/"configuration": {/,/^  }/p' "$1/manifest.json"
}
if [ ! -f ../rtl/manifest.json ] || [ "$(configuration ../rtl)" != "$(configuration .)" ]; then
    echo 'error: ../rtl does not hold the machine that this self-test belongs to: run dynrt generate with the same configuration' >&2
    exit 1
fi
iverilog=$(need 'apt-get install iverilog' iverilog)
"$iverilog" -g2001 -s dynrt_selftest_tb -o build/dynrt_selftest_tb -f dynrt_selftest.f dynrt_selftest_tb.v
verdict=$(vvp -n build/dynrt_selftest_tb)
echo "$verdict"
case $verdict in PASS*) ;; *) exit 1 ;; esac
