#!/bin/sh
# dynrt_selftest.v to a bitstream for a Virtex-4 LX160, by ISE (10.1 to 14.7, whichever has the device).
# Usage: sh ise.sh        synthesis by XST
#        sh ise.sh edif   from what edif.sh has synthesised with Yosys
# The result is build/dynrt_selftest.bit, the timing build/dynrt_selftest.twr.
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
ise() {
    for tool; do need 'install ISE and source its settings script' "$tool" >/dev/null; done
}
rm -f build/dynrt_selftest.bit
ise ngdbuild map par trce bitgen
case ${1-xst} in
    xst)
        ise xst
        netlist=dynrt_selftest.ngc
        missing='XST has not written it, see build/dynrt_selftest.syr'
        rm -f "build/$netlist"
        xst -intstyle silent -ifn dynrt_selftest.xst -ofn build/dynrt_selftest.syr
        ;;
    edif)
        netlist=dynrt_selftest.edif
        missing='run sh edif.sh first'
        ;;
    *)
        echo 'usage: sh ise.sh [xst|edif]' >&2
        exit 2
        ;;
esac
cd build
[ -f "$netlist" ] || { echo "error: build/$netlist is missing: $missing" >&2; exit 1; }
ngdbuild -intstyle silent -p xc4vlx160-10-ff1148 -uc ../dynrt_selftest.ucf "$netlist" dynrt_selftest.ngd
map -intstyle silent -p xc4vlx160-10-ff1148 -timing -ol high -pr b -w -o dynrt_selftest_map.ncd dynrt_selftest.ngd dynrt_selftest.pcf
par -intstyle silent -ol high -w dynrt_selftest_map.ncd dynrt_selftest.ncd dynrt_selftest.pcf
trce -intstyle silent -v 10 -o dynrt_selftest.twr dynrt_selftest.ncd dynrt_selftest.pcf
# A missed clock is only a warning, and bitgen runs in any case.
grep -q 'All constraints were met' dynrt_selftest.par || echo 'warning: the clock is missed, see build/dynrt_selftest.twr' >&2
bitgen -intstyle silent -w dynrt_selftest.ncd dynrt_selftest.bit dynrt_selftest.pcf
