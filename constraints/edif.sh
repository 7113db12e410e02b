#!/bin/sh
# dynrt_selftest.v to EDIF for a Virtex-4, by Yosys: build/dynrt_selftest.edif, which sh ise.sh edif takes to a bitstream.
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
yosys=$(need 'apt-get install yosys' yosys)
rm -f build/dynrt_selftest.edif
"$yosys" -q -l build/edif.log -p "read_verilog $(tr '\n' ' ' <dynrt_selftest.f); synth_xilinx -family xc4v -ise -flatten -nowidelut -top dynrt_selftest; write_edif -pvector bra build/dynrt_selftest.part"
mv build/dynrt_selftest.part build/dynrt_selftest.edif
